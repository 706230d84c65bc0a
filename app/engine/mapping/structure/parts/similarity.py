"""Transforms between parts of a reconstruction, whose units differ: rotation, translation and scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.geometry.alignment import average_poses
from app.geometry.se3 import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Similarity:
    """A `target_from_source`: x_target = scale * rotation @ x_source + translation."""

    rigid: Pose
    scale: float

    @staticmethod
    def identity() -> Similarity:
        """Return the identity."""
        return Similarity(Pose.identity(), 1.0)

    @staticmethod
    def of_camera(in_source: Pose, in_target: Pose, scale: float) -> Similarity:
        """Return the one that moves a camera's pose in the source to its pose in the target, at a known scale."""
        rotation = in_target.rotation @ in_source.rotation.T
        return Similarity(
            Pose(rotation, in_target.translation - scale * rotation @ in_source.translation), scale
        )

    def apply(self, points: Array) -> Array:
        """Return points (..., 3) of the source in the target."""
        return np.asarray(self.scale * points @ self.rigid.rotation.T + self.rigid.translation)

    def move(self, pose: Pose) -> Pose:
        """Return the pose of a camera of the source in the target."""
        return Pose(self.rigid.rotation @ pose.rotation, self.apply(pose.translation))

    def inverse(self) -> Similarity:
        """Return `source_from_target`."""
        back = self.rigid.rotation.T
        return Similarity(Pose(back, -back @ self.rigid.translation / self.scale), 1.0 / self.scale)

    def __matmul__(self, other: Similarity) -> Similarity:
        """Return the composition: `a_from_b @ b_from_c` is `a_from_c`."""
        rotation = self.rigid.rotation @ other.rigid.rotation
        return Similarity(Pose(rotation, self.apply(other.rigid.translation)), self.scale * other.scale)


def average_similarity(in_source: Sequence[Pose], in_target: Sequence[Pose], scales: Array) -> Similarity:
    """Return the one that fits cameras with poses in both frames best, by medians; `scales` (n,) are those of each."""
    scale = float(np.exp(np.median(np.log(scales))))
    own = [Similarity.of_camera(a, b, scale).rigid for a, b in zip(in_source, in_target, strict=True)]
    rotation = average_poses(own).rotation
    left = [
        b.translation - scale * rotation @ a.translation for a, b in zip(in_source, in_target, strict=True)
    ]
    return Similarity(Pose(rotation, np.median(left, axis=0)), scale)
