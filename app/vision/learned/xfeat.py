"""Decode the dense maps of `xfeat.onnx` into keypoints, scores and descriptors, as the published XFeat does.

NumPy, SciPy and OpenCV only. `export_xfeat.py` checks it against the PyTorch reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from app.limits import limit

# The network has one descriptor and one reliability for each cell of this size.
CELL_PX = 8
# The coefficient of PyTorch's bicubic sampling.
CUBIC_A = -0.75

Floats = NDArray[np.float32]
Pixels = NDArray[np.int64]
Weights = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodingOptions:
    """Which pixels of XFeat's heatmap are keypoints."""

    max_features: int = limit(
        4096,
        "Keypoints with the highest scores that are kept.",
        chosen="The published XFeat's value.",
    )
    min_probability: float = limit(
        0.05,
        "Least probability of a keypoint.",
        chosen="The published XFeat's value.",
    )
    suppression_px: int = limit(
        5,
        "Side of the square in which a keypoint is the maximum.",
        chosen="The published XFeat's value.",
    )


OPTIONS = DecodingOptions()


def decode(
    features: Floats,
    keypoints: Floats,
    reliability: Floats,
    top_k: int = OPTIONS.max_features,
    threshold: float = OPTIONS.min_probability,
) -> tuple[Floats, Floats, Floats]:
    """Return keypoints (N, 2) as u, v in pixels of the network's input, scores (N,), unit descriptors (N, 64).

    Takes the outputs of the network for one image: features (1, 64, H/8, W/8) of unit length per cell,
    keypoint heatmap (1, 1, H, W), reliability (1, 1, H/8, W/8). Sorted by descending score.
    """
    heatmap = keypoints[0, 0]
    v_px, u_px = _local_maxima(heatmap, threshold)
    reliable = _sampler(u_px, v_px, heatmap.shape, _linear_weights) @ reliability.reshape(-1)
    scores = heatmap[v_px, u_px] * reliable
    best = _best(scores, top_k)
    u_px, v_px = u_px[best], v_px[best]
    cells = features.reshape(features.shape[1], -1).T
    descriptors = _sampler(u_px, v_px, heatmap.shape, _cubic_weights) @ np.ascontiguousarray(cells)
    descriptors /= np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-12)
    return np.stack([u_px, v_px], axis=1).astype(np.float32), scores[best], descriptors


def _local_maxima(heatmap: Floats, threshold: float) -> tuple[Pixels, Pixels]:
    """Return rows and columns of the pixels above `threshold` that are the maximum of the square around them.

    The last row, the last column and pixel (0, 0) are excluded, as in the reference, which gives them no score.
    """
    highest = cv2.dilate(heatmap, np.ones((OPTIONS.suppression_px, OPTIONS.suppression_px), np.uint8))
    found = cv2.compare(heatmap, np.maximum(highest, np.float32(threshold)), cv2.CMP_GE)
    found[-1], found[:, -1], found[0, 0] = 0, 0, 0
    rows, columns = np.divmod(np.flatnonzero(found), heatmap.shape[1])
    above = heatmap[rows, columns] > threshold
    return rows[above], columns[above]


def _best(scores: Floats, top_k: int) -> NDArray[np.int64]:
    """Return the indices of the `top_k` highest positive scores, highest first."""
    candidates = np.flatnonzero(scores > 0)
    if len(candidates) > top_k:
        candidates = candidates[np.argpartition(-scores[candidates], top_k)[:top_k]]
    return candidates[np.argsort(-scores[candidates], kind="stable")]


def _linear_weights(fraction: Floats) -> Floats:
    """Return the weights (N, 2) of the cells at 0 and +1 for a position `fraction` (N,) of a cell after the first."""
    return np.stack([1 - fraction, fraction], axis=1)


def _cubic_weights(fraction: Floats) -> Floats:
    """Return the weights (N, 4) of the cells -1, 0, +1, +2 for a position `fraction` (N,) of a cell after cell 0."""
    near = np.stack([fraction, 1 - fraction], axis=1)
    far = near + 1
    near_weights = ((CUBIC_A + 2) * near - (CUBIC_A + 3)) * near**2 + 1
    far_weights = CUBIC_A * (((far - 5) * far + 8) * far - 4)
    return np.concatenate([far_weights[:, :1], near_weights, far_weights[:, 1:]], axis=1)


def _sampler(
    u_px: Pixels | NDArray[np.float64],
    v_px: Pixels | NDArray[np.float64],
    image_shape: tuple[int, ...],
    weigh: Weights,
) -> csr_array:
    """Return the matrix (N, cells) that samples a map of cells of 8x8 pixels at the given pixels.

    Pixel p of n is at p / (n - 1) * n / 8 - 1/2 cells: like the reference, which mixes the two conventions for the
    corners of images. Cells outside the map are zero.
    """
    height, width = (size // CELL_PX for size in image_shape)
    columns, column_weights = _taps(u_px, image_shape[1], weigh)
    rows, row_weights = _taps(v_px, image_shape[0], weigh)
    cells = rows[:, :, None] * width + columns[:, None, :]
    weights = row_weights[:, :, None] * column_weights[:, None, :]
    starts = np.arange(len(cells) + 1) * (columns.shape[1] ** 2)
    return csr_array((weights.ravel(), cells.ravel(), starts), shape=(len(cells), height * width))


def _taps(
    position_px: Pixels | NDArray[np.float64], size_px: int, weigh: Weights
) -> tuple[NDArray[np.int32], Floats]:
    """Return the cells (N, 2 or 4) around positions along one axis, and their weights, 0 outside the map."""
    cells = size_px // CELL_PX
    position = (position_px * (cells / (size_px - 1)) - 0.5).astype(np.float32)
    first = np.floor(position)
    weights = weigh(position - first)
    reach = weights.shape[1] // 2
    touched = first.astype(np.int32)[:, None] + np.arange(1 - reach, 1 + reach, dtype=np.int32)
    weights[(touched < 0) | (touched >= cells)] = 0
    return np.clip(touched, 0, cells - 1), weights
