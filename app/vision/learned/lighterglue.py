"""LighterGlue: a small network that matches XFeat's features of two pictures, by ONNX Runtime."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.limits import limit
from app.vision.local_features import MODELS_DIR
from app.vision.onnx_session import open_session

Rows = NDArray[np.intp]
# The network was exported for at least this many features of each picture.
MIN_FEATURES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LighterGlueOptions:
    """Which of the network's matches are taken."""

    min_probability: float = limit(
        0.1, "Least probability of a match.", chosen="The published LighterGlue's value."
    )


OPTIONS = LighterGlueOptions()


@dataclass(frozen=True, slots=True)
class PictureFeatures:
    """XFeat's features of a picture of `size_px` (width, height): keypoints (n, 2) and descriptors (n, 64)."""

    keypoints_px: NDArray[np.float32]
    descriptors: NDArray[np.float32] | NDArray[np.float16]
    size_px: tuple[int, int]

    def __len__(self) -> int:
        return len(self.keypoints_px)

    @property
    def points(self) -> NDArray[np.float32]:
        """The keypoints (n, 2) relative to the picture's middle, in halves of its longer side."""
        size = np.array(self.size_px, np.float32)
        return np.asarray((self.keypoints_px - size / 2) / (size.max() / 2), np.float32)


class LighterGlue:
    """The network; safe to share between threads."""

    def __init__(self, threads: int = 1) -> None:
        self._session = open_session(MODELS_DIR / "lighterglue.onnx", threads)

    def match(self, a: PictureFeatures, b: PictureFeatures) -> tuple[Rows, Rows, NDArray[np.float32]]:
        """Return the rows of both pictures' features that match each other best, and the probability of each match."""
        if min(len(a), len(b)) < MIN_FEATURES:
            return np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0, np.float32)
        inputs = {
            "points_a": a.points,
            "descriptors_a": np.asarray(a.descriptors, np.float32),
            "points_b": b.points,
            "descriptors_b": np.asarray(b.descriptors, np.float32),
        }
        (scores,) = self._session.run(["scores"], inputs)
        best = scores.argmax(axis=1)
        rows = np.arange(len(scores))
        probability = np.exp(scores[rows, best])
        good = (scores.argmax(axis=0)[best] == rows) & (probability > OPTIONS.min_probability)
        return rows[good], best[good], probability[good]
