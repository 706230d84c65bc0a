"""Decode the dense maps of `xfeat.onnx` into keypoints, scores and descriptors, as the published XFeat does.

NumPy, SciPy and OpenCV only. `export_xfeat.py` checks it against the PyTorch reference.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

CELL_PX = 8
NMS_PX = 5
CUBIC_A = -0.75  # the coefficient PyTorch uses for bicubic sampling

Floats = NDArray[np.float32]
Pixels = NDArray[np.int64]
Weights = Callable[[Floats], Floats]


def decode(
    features: Floats,
    keypoints: Floats,
    reliability: Floats,
    top_k: int = 4096,
    threshold: float = 0.05,
) -> tuple[Floats, Floats, Floats]:
    """Keypoints (N, 2) as u, v in pixels of the network's input, scores (N,), unit descriptors (N, 64).

    Takes the outputs of the network for one image: features (1, 64, H/8, W/8) of unit length per cell,
    keypoint heatmap (1, 1, H, W), reliability (1, 1, H/8, W/8). Ordered by descending score.
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
    """Rows and columns of the pixels above `threshold` that are the maximum of the 5x5 around them.

    The last row and column and pixel (0, 0) are left out, for the reference gives them no score.
    """
    highest = cv2.dilate(heatmap, np.ones((NMS_PX, NMS_PX), np.uint8))
    found = cv2.compare(heatmap, np.maximum(highest, np.float32(threshold)), cv2.CMP_GE)
    found[-1], found[:, -1], found[0, 0] = 0, 0, 0
    rows, columns = np.divmod(np.flatnonzero(found), heatmap.shape[1])
    above = heatmap[rows, columns] > threshold
    return rows[above], columns[above]


def _best(scores: Floats, top_k: int) -> NDArray[np.int64]:
    """Indices of the `top_k` highest positive scores, highest first."""
    candidates = np.flatnonzero(scores > 0)
    if len(candidates) > top_k:
        candidates = candidates[np.argpartition(-scores[candidates], top_k)[:top_k]]
    return candidates[np.argsort(-scores[candidates], kind="stable")]


def _linear_weights(fraction: Floats) -> Floats:
    """Weights (N, 2) of the cells at 0 and +1 for a position `fraction` of a cell past the first."""
    return np.stack([1 - fraction, fraction], axis=1)


def _cubic_weights(fraction: Floats) -> Floats:
    """Weights (N, 4) of the cells at -1, 0, +1 and +2 for a position `fraction` of a cell past cell 0."""
    near = np.stack([fraction, 1 - fraction], axis=1)
    far = near + 1
    near_weights = ((CUBIC_A + 2) * near - (CUBIC_A + 3)) * near**2 + 1
    far_weights = CUBIC_A * (((far - 5) * far + 8) * far - 4)
    return np.concatenate([far_weights[:, :1], near_weights, far_weights[:, 1:]], axis=1)


def _sampler(u_px: Pixels, v_px: Pixels, image_shape: tuple[int, ...], weigh: Weights) -> csr_array:
    """The matrix (N, cells) that samples a map of 8x8-pixel cells at the given pixels.

    Pixel p of n lies at p / (n - 1) * n / 8 - 1/2 cells, the reference's mixture of both corner conventions;
    cells outside the map count as zero.
    """
    height, width = (size // CELL_PX for size in image_shape)
    columns, column_weights = _taps(u_px, image_shape[1], weigh)
    rows, row_weights = _taps(v_px, image_shape[0], weigh)
    cells = rows[:, :, None] * width + columns[:, None, :]
    weights = row_weights[:, :, None] * column_weights[:, None, :]
    starts = np.arange(len(cells) + 1) * (columns.shape[1] ** 2)
    return csr_array((weights.ravel(), cells.ravel(), starts), shape=(len(cells), height * width))


def _taps(position_px: Pixels, size_px: int, weigh: Weights) -> tuple[NDArray[np.int32], Floats]:
    """Cells (N, 2 or 4) that a position along one axis touches, and their weights; outside ones get zero."""
    cells = size_px // CELL_PX
    position = (position_px * (cells / (size_px - 1)) - 0.5).astype(np.float32)
    first = np.floor(position)
    weights = weigh(position - first)
    reach = weights.shape[1] // 2
    touched = first.astype(np.int32)[:, None] + np.arange(1 - reach, 1 + reach, dtype=np.int32)
    weights[(touched < 0) | (touched >= cells)] = 0
    return np.clip(touched, 0, cells - 1), weights
