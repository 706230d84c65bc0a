"""The depths that the depth images of a reconstruction measured at its features."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.depth import DepthImage, sample_depth
from app.limits import limit

Array = NDArray[np.float64]
# Returns the depth image (height, width) in metres of a picture, by its row.
DepthOf = Callable[[int], DepthImage]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredOptions:
    """How much is compared."""

    pictures: int = limit(60, "Pictures whose depths are compared.", chosen="By hand: a second.")


OPTIONS = MeasuredOptions()


@dataclass(frozen=True, slots=True)
class DepthRatios:
    """The measured depth over the reconstructed one of each feature that has both (n,), metres per unit."""

    ratios: Array

    @property
    def metres_per_unit(self) -> float:
        """The median ratio."""
        return float(np.median(self.ratios))

    @property
    def deviation(self) -> float:
        """The median relative deviation from it: large where one path has several scales."""
        return float(np.median(np.abs(self.ratios / self.metres_per_unit - 1.0)))


def depth_ratios(part: Reconstruction, depth_of: DepthOf) -> DepthRatios:
    """Return the ratios of some pictures, evenly spread."""
    rows = list(part.poses)
    step = max(1, -(-len(rows) // OPTIONS.pictures))
    return DepthRatios(np.concatenate([_ratios(row, part, depth_of(row)) for row in rows[::step]]))


def _ratios(row: int, part: Reconstruction, depth_m: DepthImage) -> Array:
    points = part.points[part.observations[part.observations[:, 0] == row, 2]]
    in_camera = part.poses[row].inverse().apply(points)
    pixels = part.camera.project(in_camera)
    seen = np.isfinite(pixels).all(axis=1)
    measured_m = sample_depth(depth_m, pixels[seen])
    has_both = measured_m > 0
    return np.asarray(measured_m[has_both] / in_camera[seen, 2][has_both], dtype=np.float64)
