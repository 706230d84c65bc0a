"""What in a map looks like something elsewhere in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import Descriptors
from app.vision.keyframes import PoseThresholds, select_by_pose, thresholds_for_matches
from app.vision.repetition import RunChunks, find_repetition


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacingOptions:
    """Which keyframes are views of their own."""

    spacing_share: float = limit(
        0.9,
        "Keyframes closer than this share of the pose rule's thresholds are one view: in a map of "
        "every frame of a video each thing has so many features that they hide what looks like it "
        "elsewhere.",
        chosen="roomfix evaluate-demo and evaluate; docs/features.md.",
    )


OPTIONS = SpacingOptions()


def views_of(poses: Sequence[Pose]) -> NDArray[np.int64]:
    """Return the keyframes (v,) that are views of their own, by the poses of all."""
    usual = thresholds_for_matches()
    spacing = PoseThresholds(
        OPTIONS.spacing_share * usual.position_m, OPTIONS.spacing_share * usual.attitude_rad
    )
    return np.array(select_by_pose(poses, spacing), np.int64)


def rows_of_keyframes(keyframes: NDArray[np.int64], offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows (m,) of the features of keyframes (v,), by the `offsets` of the features of all."""
    chosen = [np.arange(offsets[row], offsets[row + 1]) for row in keyframes]
    return np.concatenate([*chosen, np.zeros(0, np.int64)]).astype(np.int64)


def elsewhere(
    descriptors: Descriptors | NDArray[np.float16],
    binary: bool,
    points_in_world: NDArray[np.float32],
    offsets: NDArray[np.int64],
    poses: Sequence[Pose],
    z_up: bool = True,
    run: RunChunks = map,
) -> tuple[NDArray[np.float16], NDArray[np.int32]]:
    """Return a map's `distance_elsewhere` and `keyframe_elsewhere` (both (f,)) from its other arrays, its keyframes'
    poses, and whether z is known to point up; `run` as in `find_repetition`."""
    rows = rows_of_keyframes(views_of(poses), offsets)
    found = find_repetition(descriptors, binary, points_in_world, rows, z_up, run)
    keyframes = np.searchsorted(offsets, found.row, side="right") - 1
    return found.distance.astype(np.float16), np.where(found.row < 0, -1, keyframes).astype(np.int32)
