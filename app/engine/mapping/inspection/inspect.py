"""The inspection of a scan: figures, findings, and the plan of a build."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.engine.mapping.build_map import scan_placement, supporting_rows
from app.engine.mapping.examination.consistency import DRIFT
from app.engine.mapping.examination.examine import examine_scan
from app.engine.mapping.examination.outcome import Examination
from app.engine.mapping.inspection.figures import ScanFigures, figures_of, positions_of
from app.engine.mapping.inspection.loops import SampledLoops, sampled_loops
from app.engine.mapping.inspection.path_picture import path_picture
from app.engine.mapping.options import BuildOptions
from app.engine.progress import Progress
from app.importers.frames import Scan
from app.vision.keyframes import select_by_pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """What a scan holds and what a build with these options would do; `path_svg` is its path from above.

    `keyframes` and `supporting` are numbers of frames by the pose rule, None for another rule, which looks at the
    pictures. `examination` is None for a scan whose poses are a stated motion. `loops` is None for that too, for a scan
    without depth, and for one that something else than drift is wrong with.
    """

    format: str
    figures: ScanFigures
    examination: Examination | None
    loops: SampledLoops | None
    keyframes: int | None
    supporting: int | None
    notes: tuple[str, ...]
    path_svg: str

    def as_dict(self) -> dict[str, Any]:
        """Return the inspection for JSON."""
        refused = self.examination is not None and self.examination.verdict == "refused"
        return {
            "format": self.format,
            **self.figures.as_dict(),
            "examination": None if self.examination is None else self.examination.as_dict(),
            "loops": None if self.loops is None else self.loops.as_dict(),
            "build": {
                "would": "refuse" if refused else "build",
                "keyframes": self.keyframes,
                "supporting_frames": self.supporting,
                "points": "from depth" if self.figures.depth else "triangulated",
                "plan_positions": self.figures.z_up,
                "pictures": None,
                "camera": None,
                "scale": None,
            },
            "notes": list(self.notes),
            "path_svg": self.path_svg,
        }


def inspect_scan(
    scan: Scan, name: str, options: BuildOptions, executor: Executor, progress: Progress
) -> Inspection:
    """Return the inspection of a scan of the format `name`; needs no map and no model, and takes seconds."""
    gravity = options.gravity or scan.gravity
    examined = None
    if options.scan.motion is None:
        examined = examine_scan(
            scan, options.scan, gravity, executor, progress, up_is_known=options.world_from_scan is not None
        )
    may_drift = examined is not None and all(one.code == DRIFT for one in examined.wrong)
    loops = sampled_loops(scan, executor, progress) if may_drift else None
    placed = scan_placement(options, scan)
    poses = [placed @ frame.scan_from_camera for frame in scan.frames]
    rule = options.keyframes
    by_pose = rule.rule == "pose" and not rule.calibrated
    rows = select_by_pose(poses, rule.thresholds) if by_pose else []
    axes = np.stack([pose.rotation[:, 2] for pose in poses])
    return Inspection(
        format=name,
        figures=figures_of(scan, gravity),
        examination=examined,
        loops=loops,
        keyframes=len(rows) if by_pose else None,
        supporting=len(supporting_rows(poses, rule, rows)) if by_pose and options.refine_depth else None,
        notes=scan.notes,
        path_svg=path_picture(positions_of(scan, gravity), axes, rows),
    )
