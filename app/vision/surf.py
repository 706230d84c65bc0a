"""SURF, the Visual-Depth Map paper's features, by mahotas (the `surf` extra); OpenCV's wheels don't have it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mahotas.features import surf

from app.limits import limit
from app.vision.features import LocalFeatureExtractor, LocalFeatures
from app.vision.images import Gray, shrink

# Columns of mahotas's result: row and column of the point, and the descriptor.
POSITION = slice(0, 2)
DESCRIPTOR = slice(6, 70)


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfOptions:
    """SURF."""

    ratio: float = limit(
        0.85,
        "Largest distance of the best match over that of the second best.",
        chosen="By hand: the geometric checks reject the false matches that pass it.",
    )
    min_inliers: int = limit(
        24,
        "Least number of inliers of a pose.",
        chosen="By hand: twice that of SIFT.",
    )
    max_side_px: int = limit(
        480,
        "Length to which a picture's longer side is reduced.",
        chosen="By hand: it finds as many points as SIFT does at its own size; larger pictures take seconds.",
    )
    max_features: int = limit(
        1000,
        "Largest number of features of a picture.",
        chosen="By hand: bounds the time of matching.",
    )
    min_response: float = limit(
        1.0,
        "Least response of a point: mahotas's `threshold`.",
        chosen="By hand: low, because the strongest points are kept.",
    )


OPTIONS = SurfOptions()


class Surf:
    """SURF's descriptors of 64 numbers, of unit length."""

    binary = False
    ratio = OPTIONS.ratio
    min_inliers = OPTIONS.min_inliers
    descriptor_size = 64
    descriptor_dtype: type[np.uint8] | type[np.float32] = np.float32
    name = "surf"

    def extract(self, gray: Gray) -> LocalFeatures:
        """Return the features of a grey image (height, width), strongest first."""
        small, scale = shrink(gray, OPTIONS.max_side_px)
        points = surf.surf(small, threshold=OPTIONS.min_response, max_points=OPTIONS.max_features)
        found = np.asarray(points, dtype=np.float64)
        found = found.reshape(-1, DESCRIPTOR.stop)
        found = found[np.isfinite(found).all(axis=1)]
        # mahotas returns row and column, so v and u.
        at = found[:, POSITION][:, ::-1]
        return LocalFeatures(
            ((at + 0.5) / scale - 0.5).astype(np.float32), found[:, DESCRIPTOR].astype(np.float32)
        )

    def for_faint_images(self) -> LocalFeatureExtractor | None:
        """Return None."""
        return None
