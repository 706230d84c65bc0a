"""SURF, the Visual-Depth Map paper's features, by mahotas (the `surf` extra); OpenCV's wheels don't have it."""

from __future__ import annotations

import numpy as np
from mahotas.features import surf

from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, shrink

# Finds as many points as SIFT does at its own size; larger images take seconds.
SIDE_PX, MAX_FEATURES, THRESHOLD = 480, 1000, 1.0
POSITION, DESCRIPTOR = slice(0, 2), slice(6, 70)


class Surf:
    """SURF's 64 numbers, unit vectors, on the image shrunk to 480 px."""

    binary = False
    ratio = 0.85
    min_inliers = 24
    descriptor_size = 64
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.float32
    name = "surf"

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width), strongest first."""
        small, scale = shrink(gray, SIDE_PX)
        found = np.asarray(surf.surf(small, threshold=THRESHOLD, max_points=MAX_FEATURES), dtype=np.float64)
        found = found.reshape(-1, DESCRIPTOR.stop)
        found = found[np.isfinite(found).all(axis=1)]
        # mahotas gives row and column.
        at = found[:, POSITION][:, ::-1]
        return LocalFeatures(
            ((at + 0.5) / scale - 0.5).astype(np.float32), found[:, DESCRIPTOR].astype(np.float32)
        )

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None
