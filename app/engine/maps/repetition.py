"""What in a map looks like something elsewhere in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.features import Descriptors
from app.vision.keyframes import PoseThresholds, select_by_pose, thresholds_for_matches
from app.vision.repetition import Rays, RunChunks, find_repetition, find_repetition_on_rays


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacingOptions:
    """Which keyframes are views of their own, and which look alike."""

    spacing_share: float = limit(
        0.9,
        "Keyframes closer than this share of the pose rule's thresholds are one view: in a map of "
        "every frame of a video each thing has so many features that they hide what looks like it "
        "elsewhere.",
        chosen="roomfix evaluate-demo and evaluate; docs/features.md.",
    )

    min_alike_cosine: float = limit(
        0.75,
        "Cosine of global descriptors from which on a feature without a point counts in another keyframe.",
        chosen="As of places that look alike, whose poses need more evidence.",
    )


OPTIONS = SpacingOptions()


@dataclass(frozen=True, slots=True)
class Unplaced:
    """Features of keyframes that have no point: descriptors (m, d), keyframes (m,), and rays (m, 3) in the camera's
    axes; and the global descriptors (k, g) of all keyframes."""

    descriptors: Descriptors
    keyframes: NDArray[np.int64]
    rays_in_camera: NDArray[np.float64]
    global_descriptors: NDArray[np.float32]

    @property
    def alike(self) -> NDArray[np.bool_]:
        """Which keyframes (k, k) look alike."""
        unit = self.global_descriptors
        return np.asarray(unit @ unit.T >= OPTIONS.min_alike_cosine)

    def of_keyframes(self, keyframes: NDArray[np.int64]) -> Unplaced:
        """Return those of some keyframes."""
        kept = np.isin(self.keyframes, keyframes)
        return replace(
            self,
            descriptors=self.descriptors[kept],
            keyframes=self.keyframes[kept],
            rays_in_camera=self.rays_in_camera[kept],
        )

    def rays(self, poses: Sequence[Pose]) -> Rays:
        """Return their rays in the world, by the `world_from_camera` of all keyframes."""
        turns = np.stack([pose.rotation for pose in poses])[self.keyframes]
        centres = np.stack([pose.translation for pose in poses])[self.keyframes]
        ahead = np.einsum("nij,nj->ni", turns, self.rays_in_camera)
        return Rays(
            self.descriptors, self.keyframes, centres, ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        )


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
    unplaced: Unplaced | None = None,
) -> tuple[NDArray[np.float16], NDArray[np.int32]]:
    """Return a map's `distance_elsewhere` and `keyframe_elsewhere` (both (f,)) from its other arrays, its keyframes'
    poses, and whether z is known to point up; `run` as in `find_repetition`.

    `unplaced` are the keyframes' features without points, where there are many: what resembles one of them is not
    distinct, though no match with it can say so.
    """
    views = views_of(poses)
    rows = rows_of_keyframes(views, offsets)
    found = find_repetition(descriptors, binary, points_in_world, rows, z_up, run)
    keyframes = np.where(found.row < 0, -1, np.searchsorted(offsets, found.row, side="right") - 1)
    distance = found.distance
    if unplaced is not None:
        seen = unplaced.of_keyframes(views)
        keyframe_of = np.repeat(np.arange(len(poses)), np.diff(offsets))
        other = find_repetition_on_rays(
            descriptors, binary, points_in_world, keyframe_of, seen.rays(poses), seen.alike, z_up, run
        )
        is_nearer = other.distance < distance
        distance = np.where(is_nearer, other.distance, distance)
        own = (
            np.where(other.row < 0, -1, seen.keyframes[np.maximum(other.row, 0)])
            if len(seen.keyframes)
            else -1
        )
        keyframes = np.where(is_nearer, own, keyframes)
    return distance.astype(np.float16), keyframes.astype(np.int32)
