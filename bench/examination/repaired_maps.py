"""Maps of scans as they may be built, repaired where they had to be, by queries of the right scan."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from app.engine.mapping.build_map import build_map, scan_placement
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.self_check import check_map
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.alignment import average_poses
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.services.examine_scan import ExaminedScan
from bench.evaluation.pose_errors import pose_error


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """How many queries a map located, their median errors, and what the self-check warned of or refused.

    A remedy may leave the map in another frame of the world, so the errors are those after the rigid motion on
    which the answers agree.
    """

    tried: int
    located: int
    median_m: float | None = None
    median_deg: float | None = None
    told: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The figures in short."""
        shown = f"{self.located}/{self.tried}"
        if self.median_m is not None and self.median_deg is not None:
            shown += f", {100 * self.median_m:.1f}, {self.median_deg:.2f}"
        return shown + ("; told" if self.told else "")


def locate_in_repaired(
    examined: ExaminedScan,
    right: Scan,
    queries: Sequence[Frame],
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> Located:
    """Build the map of an examined scan, and locate frames of the right one in it."""
    placed = scan_placement(examined.options, examined.scan)
    built = build_map(examined.scan, examined.options, models, executor, progress, placed)
    try:
        check = check_map(built, examined.scan, models, executor, progress, examined.examination)
    except InvalidScanError as error:
        return Located(tried=len(queries), located=0, told=(str(error),))
    localizer = Localizer.of(check.stated_in(built.artifact), built.index, models)

    def locate(frame: Frame) -> Pose | None:
        return localizer.localize(frame_rgb(right, frame), right.camera).world_from_camera

    answers = list(map_in_order(executor, locate, queries, "locate", progress))
    pairs = [
        (found, frame.scan_from_camera)
        for found, frame in zip(answers, queries, strict=True)
        if found is not None
    ]
    if not pairs:
        return Located(tried=len(queries), located=0, told=check.warnings)
    map_from_right = average_poses([found @ truth.inverse() for found, truth in pairs])
    errors = np.array([pose_error(found, map_from_right @ truth) for found, truth in pairs])
    median_m, median_deg = (float(value) for value in np.median(errors, axis=0))
    return Located(
        tried=len(queries),
        located=len(pairs),
        median_m=round(median_m, 4),
        median_deg=round(median_deg, 3),
        told=check.warnings,
    )
