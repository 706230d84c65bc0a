"""Local features, and the protocol of their extractors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.vision.images import Gray

Descriptors = NDArray[np.uint8] | NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class LocalFeatures:
    """Keypoints (n, 2) in pixels of the full image (centre of the first pixel at 0, 0) and descriptors (n, d)."""

    keypoints_px: NDArray[np.float32]
    descriptors: Descriptors

    def __len__(self) -> int:
        return len(self.keypoints_px)

    @staticmethod
    def of_shrunk(points_px: ArrayLike, scale: float, descriptors: Descriptors) -> LocalFeatures:
        """Return the features whose points (n, 2) are those of the image after `shrink` by a scale."""
        points = np.asarray(points_px, dtype=np.float32)
        return LocalFeatures(np.asarray((points + 0.5) / scale - 0.5, dtype=np.float32), descriptors)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> LocalFeatures:
        """Return the features of the given rows."""
        return LocalFeatures(self.keypoints_px[rows], self.descriptors[rows])


class LocalFeatureExtractor(Protocol):
    """Finds and describes keypoints.

    A map records the `name`. `ratio` is the threshold of the ratio test. `min_inliers` is the least number of inliers
    of a pose, above what images of places that are not in a map reach by chance (docs/features.md).
    """

    name: str
    binary: bool
    ratio: float
    min_inliers: int
    descriptor_size: int
    descriptor_dtype: type[np.uint8] | type[np.float32]

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width), best first where the method ranks them."""
        ...

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return an extractor for images in which this one finds too little, or None if there is none."""
        ...
