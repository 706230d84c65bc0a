"""The inspection of pictures without poses: which of them a build would use, and what it would rest on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from app.engine.mapping.inspection.figures import DepthFigures, depth_figures, sensors_dict
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.structure.chosen import ChosenPictures, choose_pictures
from app.engine.mapping.structure.depth.unit import doubts_of_unit
from app.engine.mapping.structure.estimate import WITHOUT_SCALE
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import check_installed
from app.engine.mapping.structure.scale_options import frames_of, kind_of
from app.engine.progress import Progress
from app.importers.unposed.scan import UnposedScan


@dataclass(frozen=True, slots=True, kw_only=True)
class UnposedInspection:
    """What pictures hold and what a build with these options would do; whether they overlap only a build finds out.

    `scale` is what a build would take the scale from: the option's name, `depth`, or None.
    """

    format: str
    chosen: ChosenPictures
    depth: DepthFigures | None
    scale: str | None
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the inspection for JSON, with the keys of `Inspection.as_dict`."""
        scan = self.chosen.scan
        duration_s, rate_hz = _times(self.chosen)
        return {
            "format": self.format,
            "frames": self.chosen.total,
            "discarded": {reason: len(names) for reason, names in scan.discarded.items()},
            "sensors": sensors_dict(scan.camera, self.depth),
            "duration_s": duration_s,
            "rate_hz": rate_hz,
            "trajectory": None,
            "examination": None,
            "loops": None,
            "build": {
                "would": "estimate_poses",
                "keyframes": None,
                "supporting_frames": None,
                "points": "from depth" if scan.has_depth else "triangulated",
                "plan_positions": self.scale is not None,
                "pictures": len(scan.frames),
                "camera": self.chosen.camera_source,
                "scale": self.scale,
            },
            "notes": list(self.notes),
            "path_svg": None,
        }


def inspect_unposed(unposed: UnposedScan, options: BuildOptions, progress: Progress) -> UnposedInspection:
    """Return the inspection of pictures without poses; each is looked at once, none is matched.

    Raises `InvalidScanError` where a build would before it matches: too few pictures that differ, depth images whose
    unit is neither stated nor possible, and where pycolmap is not installed.
    """
    check_installed()
    chosen = choose_pictures(unposed, frames_of(options.scale), RECONSTRUCTION.min_frames, progress)
    depth = depth_figures(chosen.scan)
    scale = kind_of(options.scale) or (None if depth is None else "depth")
    notes = chosen.scan.notes
    if scale is None:
        notes = (*notes, WITHOUT_SCALE)
    elif scale == "depth":
        notes = (*notes, *doubts_of_unit(chosen.scan))
    return UnposedInspection(format=unposed.format, chosen=chosen, depth=depth, scale=scale, notes=notes)


def _times(chosen: ChosenPictures) -> tuple[float, float | None]:
    """Return the seconds from the first chosen picture to the last, and how many are a second; photos have no times."""
    times_s = [frame.timestamp_s for frame in chosen.scan.frames]
    duration_s = times_s[-1] - times_s[0] if chosen.scan.has_times else 0.0
    return round(duration_s, 2), round((len(times_s) - 1) / duration_s, 2) if duration_s > 0 else None
