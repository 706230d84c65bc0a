"""XFeat's features of the keyframes, kept beside the map's own: for frames in which those find too little."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondFeatures:
    """The n features of k keyframes; keyframe i owns `offsets[i]:offsets[i + 1]`, `offsets` (k + 1,).

    Per feature: `keypoints_px` (n, 2) in the picture, `points_in_world` (n, 3) in metres, `point_sigma_m` (n,)
    along the ray, `descriptors` (n, 64) of unit length in half precision.
    """

    offsets: NDArray[np.int64]
    keypoints_px: NDArray[np.float32]
    points_in_world: NDArray[np.float32]
    point_sigma_m: NDArray[np.float32]
    descriptors: NDArray[np.float16]

    def span(self, keyframe: int) -> slice:
        """Return the rows of a keyframe's features."""
        return slice(int(self.offsets[keyframe]), int(self.offsets[keyframe + 1]))

    @property
    def nbytes(self) -> int:
        """The size of all arrays in bytes."""
        return sum(int(getattr(self, name).nbytes) for name in SecondFeatures.__slots__)

    def take(self, keyframes: Sequence[int]) -> SecondFeatures:
        """Return the features of some keyframes, in that order."""
        spans = [self.span(int(keyframe)) for keyframe in keyframes]
        rows = np.concatenate([np.zeros(0, np.intp), *(np.arange(s.start, s.stop) for s in spans)])
        return SecondFeatures(
            offsets=np.cumsum([0, *(s.stop - s.start for s in spans)]).astype(np.int64),
            keypoints_px=self.keypoints_px[rows],
            points_in_world=self.points_in_world[rows],
            point_sigma_m=self.point_sigma_m[rows],
            descriptors=self.descriptors[rows],
        )

    @staticmethod
    def join(parts: Sequence[SecondFeatures]) -> SecondFeatures:
        """Return the features of the keyframes of all parts, at least one."""
        counts = np.concatenate([np.diff(part.offsets) for part in parts])
        return SecondFeatures(
            offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            keypoints_px=np.concatenate([part.keypoints_px for part in parts]),
            points_in_world=np.concatenate([part.points_in_world for part in parts]),
            point_sigma_m=np.concatenate([part.point_sigma_m for part in parts]),
            descriptors=np.concatenate([part.descriptors for part in parts]),
        )

    @staticmethod
    def none(keyframes: int) -> SecondFeatures:
        """Return no features of so many keyframes: those of a map that was built without them."""
        return SecondFeatures(
            offsets=np.zeros(keyframes + 1, np.int64),
            keypoints_px=np.zeros((0, 2), np.float32),
            points_in_world=np.zeros((0, 3), np.float32),
            point_sigma_m=np.zeros(0, np.float32),
            descriptors=np.zeros((0, 64), np.float16),
        )
