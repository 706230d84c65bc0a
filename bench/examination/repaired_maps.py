"""Maps of scans as they may be built, repaired where they had to be, by queries of the right scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.build_map import build_map, scan_placement
from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.options import BuildOptions
from app.engine.mapping.self_check import check_map
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress, map_in_order
from app.engine.query.localizer import Localizer
from app.errors import InvalidScanError
from app.geometry.alignment import average_poses
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan, ScanOptions
from app.services.examine_scan import ExaminedScan
from bench.evaluation.pose_errors import pose_error

# Metres, pixels and numbers of a rotation: what a text file of nine digits and a unit's conversion leave.
SAME_NUMBERS = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """How many queries a map located, their median errors, and what the self-check warned of or refused it for.

    A remedy may leave the map in another frame of the world, so the errors are those after the rigid motion on
    which the answers agree. `same_as` names the scan whose map was asked, where the repaired scan equals that one.
    """

    tried: int
    located: int
    median_m: float | None = None
    median_deg: float | None = None
    refusal: str | None = None
    warnings: tuple[str, ...] = ()
    same_as: str | None = None

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Located:
        """Return what was read from JSON."""
        return Located(**{**values, "warnings": tuple(values["warnings"])})

    @property
    def words(self) -> str:
        """The figures in short."""
        if self.refusal is not None:
            return "refused by the self-check"
        shown = f"{self.located} of {self.tried}"
        if self.median_m is not None and self.median_deg is not None:
            shown += f", {100 * self.median_m:.2f} cm, {self.median_deg:.3f} deg"
        return shown + ("; warned of" if self.warnings else "")


@dataclass(frozen=True, slots=True)
class _Content:
    """What a map is made from: options, a digest of pictures and depth, and the numbers (n,) of camera and poses."""

    options: BuildOptions
    images: str
    numbers: NDArray[np.float64]

    def is_that_of(self, other: _Content) -> bool:
        return (
            (self.options, self.images) == (other.options, other.images)
            and self.numbers.shape == other.numbers.shape
            and np.allclose(self.numbers, other.numbers, rtol=0.0, atol=SAME_NUMBERS)
        )


class RepairedMaps:
    """Maps of scans as they may be built. Scans that are the same after their repair share one."""

    def __init__(self) -> None:
        self._known: list[tuple[str, _Content, Located]] = []

    def know(
        self, name: str, scan: Scan, options: BuildOptions, located: Located, executor: Executor
    ) -> None:
        """Use what was located before in the map of a scan."""
        self._known.append((name, _content(scan, options, executor), located))

    def locate(
        self,
        name: str,
        examined: ExaminedScan,
        right: Scan,
        queries: Sequence[Frame],
        models: VisionModels,
        executor: Executor,
        progress: Progress,
    ) -> Located:
        """Locate frames of the right scan in the map of an examined one, or of one that is the same."""
        content = _content(examined.scan, examined.options, executor)
        for other, known, located in self._known:
            if content.is_that_of(known):
                return replace(located, same_as=other)
        located = locate_in_repaired(examined, right, queries, models, executor, progress)
        self._known.append((name, content, located))
        return located


def _content(scan: Scan, options: BuildOptions, executor: Executor) -> _Content:
    def images(frame: Frame) -> bytes:
        return sha256(frame_rgb(scan, frame).tobytes() + scan.depth_m(frame).tobytes()).digest()

    digest = sha256(b"".join(executor.map(images, scan.frames))).hexdigest()
    poses = [frame.scan_from_camera.matrix.ravel() for frame in scan.frames]
    gravity = np.array(options.gravity or scan.gravity or (0.0, 0.0, 0.0))
    numbers = np.concatenate([np.array(scan.camera.params), gravity, *poses])
    # How the files are read is in what was read.
    return _Content(replace(options, scan=ScanOptions(), gravity=None, repair=False), digest, numbers)


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
        return Located(tried=len(queries), located=0, refusal=str(error))
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
        return Located(tried=len(queries), located=0, warnings=check.warnings)
    map_from_right = average_poses([found @ truth.inverse() for found, truth in pairs])
    errors = np.array([pose_error(found, map_from_right @ truth) for found, truth in pairs])
    median_m, median_deg = (float(value) for value in np.median(errors, axis=0))
    return Located(
        tried=len(queries),
        located=len(pairs),
        median_m=round(median_m, 4),
        median_deg=round(median_deg, 3),
        warnings=check.warnings,
    )
