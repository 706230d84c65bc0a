"""The inspection of pictures without poses: how many of them a build would use, and what it would rest on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.mapping.inspection.figures import rate_hz, sensors_dict
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.structure.chosen import ChosenPictures, choose_pictures
from app.engine.mapping.structure.depth.unit import doubts_of_unit
from app.engine.mapping.structure.estimate import WITHOUT_SCALE
from app.engine.mapping.structure.reconstruction import OPTIONS as RECONSTRUCTION
from app.engine.mapping.structure.reconstruction import check_installed
from app.engine.mapping.structure.scale_options import kind_of
from app.engine.progress import Progress
from app.importers.depth_figures import DepthFigures, depth_figures
from app.importers.phones.video import open_video
from app.importers.unposed.scan import UnposedScan
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class UnposedOptions:
    """How many pictures an inspection looks at: a request waits for it."""

    frames: int = limit(
        300, "Frames of a video or a sensor.", chosen="By hand: ten seconds of film take some seconds."
    )
    photos: int = limit(
        30, "Photos.", chosen="By hand: a photo of 12 megapixels takes a quarter of a second."
    )


OPTIONS = UnposedOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class UnposedInspection:
    """What pictures hold and what a build with these options would do; whether they overlap only a build finds out.

    `frames` is the number of all pictures, by the header of a video. `looked_at` are those chosen among the first ones.
    `scale` is what a build would take the scale from: the option's name, `depth`, or None.
    """

    format: str
    frames: int
    duration_s: float
    rate_hz: float | None
    looked_at: ChosenPictures
    depth: DepthFigures | None
    scale: str | None
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the inspection for JSON, with the keys of `Inspection.as_dict`."""
        scan = self.looked_at.scan
        return {
            "format": self.format,
            "frames": self.frames,
            "discarded": {reason: len(names) for reason, names in scan.discarded.items()},
            "sensors": sensors_dict(scan.camera, self.depth),
            "duration_s": round(self.duration_s, 2),
            "rate_hz": None if self.rate_hz is None else round(self.rate_hz, 2),
            "trajectory": None,
            "examination": None,
            "loops": None,
            "build": {
                "would": "estimate_poses",
                "keyframes": None,
                "supporting_frames": None,
                "points": "triangulated" if self.depth is None else "from depth",
                "plan_positions": self.scale is not None,
                "pictures": round(len(scan.frames) * self.frames / self.looked_at.total),
                "camera": self.looked_at.camera_source,
                "scale": self.scale,
            },
            "notes": list(self.notes),
            "path_svg": None,
        }


def inspect_unposed(unposed: UnposedScan, options: BuildOptions, progress: Progress) -> UnposedInspection:
    """Return the inspection of pictures without poses; the first ones are looked at, none is matched.

    Raises `InvalidScanError` where a build would before it matches: too few pictures that differ, depth images whose
    unit is neither stated nor possible, and where pycolmap is not installed.
    """
    check_installed()
    frames, duration_s, rate = _extent(unposed)
    most = OPTIONS.photos if unposed.photos else OPTIONS.frames
    chosen = choose_pictures(unposed, (), RECONSTRUCTION.min_frames, progress, most=most)
    if chosen.total < most:
        # The header of a video may say more than is there.
        frames = chosen.total
    depth = depth_figures(chosen.scan)
    scale = kind_of(options.scale) or (None if depth is None else "depth")
    notes = chosen.scan.notes
    if chosen.total < frames:
        notes = (*notes, f"The first {chosen.total} of {frames} pictures were looked at.")
    if scale is None:
        notes = (*notes, WITHOUT_SCALE)
    elif scale == "depth" and depth is not None:
        notes = (*notes, *doubts_of_unit(depth, chosen.scan.depth))
    return UnposedInspection(
        format=unposed.format,
        frames=max(frames, chosen.total),
        duration_s=duration_s,
        rate_hz=rate,
        looked_at=chosen,
        depth=depth,
        scale=scale,
        notes=notes,
    )


def _extent(unposed: UnposedScan) -> tuple[int, float, float | None]:
    """Return the number of pictures, the seconds that they span, and how many are a second; photos have no times."""
    if unposed.video is not None:
        video = open_video(unposed.video)
        return video.count, video.count / video.fps if video.fps else 0.0, video.fps or None
    if unposed.listed is not None:
        times_s = np.array([frame.timestamp_s for frame in unposed.listed.frames])
    else:
        times_s = np.array([frame.time_s for frame in unposed.recorded])
    count = len(unposed.photos) or len(times_s)
    return count, float(np.ptp(times_s)) if len(times_s) else 0.0, rate_hz(times_s)
