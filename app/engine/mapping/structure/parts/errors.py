"""How well the points of a part fit each of its pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.vision.features import LocalFeatures


def errors_px(part: Reconstruction, features: Sequence[LocalFeatures]) -> dict[int, float]:
    """Return the mean distance, pixels, of each picture's points from their features; those that see none are left
    out."""
    found = {}
    for row, pose in part.poses.items():
        seen = part.observations[part.observations[:, 0] == row]
        expected = part.camera.project(pose.inverse().apply(part.points[seen[:, 2]]))
        apart = np.linalg.norm(expected - features[row].keypoints_px[seen[:, 1]], axis=1)
        in_view = np.isfinite(apart)
        if in_view.any():
            found[row] = float(apart[in_view].mean())
    return found
