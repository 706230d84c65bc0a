"""What loop closure leaves of drift that is added to a scan's poses."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.loops.close import ClosedLoops, close_loops
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import Progress
from app.geometry.alignment import align_points
from app.geometry.se3 import Pose
from app.importers.frames import Scan
from bench.drift.odometry import with_drift

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftResult:
    """A scan with drift (0.01 is one percent) of a seed: root mean square errors of its positions in metres, after the
    best rigid alignment, before and after loop closure."""

    drift_ratio: float
    seed: int
    closed: ClosedLoops
    before_m: float
    after_m: float


def close_with_drift(
    scan: Scan,
    drift_ratio: float,
    seed: int,
    models: VisionModels,
    executor: Executor,
    progress: Progress,
) -> DriftResult:
    """Add drift to a scan whose poses are right, and close its loops."""
    true = poses_of(scan)
    drifted = with_drift(true, drift_ratio, seed) if drift_ratio else true
    frames = (replace(f, scan_from_camera=pose) for f, pose in zip(scan.frames, drifted, strict=True))
    closed = close_loops(replace(scan, frames=tuple(frames)), models, executor, progress)
    return DriftResult(
        drift_ratio=drift_ratio,
        seed=seed,
        closed=closed,
        before_m=error_m(drifted, true),
        after_m=error_m(poses_of(closed.scan), true),
    )


def poses_of(scan: Scan) -> list[Pose]:
    """Return the poses of a scan's frames."""
    return [frame.scan_from_camera for frame in scan.frames]


def error_m(path: Sequence[Pose], true: Sequence[Pose]) -> float:
    """Return the root mean square error of the positions of a path after the best rigid alignment."""
    found = align_points([pose.translation for pose in path], [pose.translation for pose in true])
    return found.residual_rms_m
