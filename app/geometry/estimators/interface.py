"""What a robust estimator of poses offers, whichever library does the work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from app.geometry.camera import Camera
from app.geometry.rigs.view import RigView
from app.geometry.se3 import Pose

Array = NDArray[np.float64]

# Any three points fit a pose exactly: only a fourth one confirms it.
MIN_POINTS = 4
# A linear estimate of a fundamental matrix needs eight matches.
MIN_FUNDAMENTAL_POINTS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class RansacBudget:
    """The inlier limit of a search and how many samples it may draw.

    With `sorted_by_quality` the matches are sorted, best first, and samples are drawn from the best first (PROSAC).
    """

    max_error_px: float
    max_iterations: int
    min_iterations: int
    seed: int
    sorted_by_quality: bool = False


@dataclass(frozen=True, slots=True)
class AbsolutePose:
    """A camera's pose, and the number of RANSAC samples, 0 when the estimator doesn't report it."""

    world_from_camera: Pose
    iterations: int


class Estimators(Protocol):
    """Absolute and relative poses by locally optimized RANSAC. The same input and seed give the same answer."""

    name: str

    def absolute_poses(
        self,
        pixels: Array,
        points: Array,
        searches: Sequence[tuple[Camera, RansacBudget]],
        *,
        loss_scale_px: float,
        prior: Pose | None,
    ) -> list[AbsolutePose | None]:
        """Return, for each of several cameras, the pose with the most inliers among pixels (n, 2) and world points
        (n, 3), n >= 4, or None.

        It is refined on its inliers by the Cauchy loss with `loss_scale_px`. `prior` is a `world_from_camera` that
        is tried besides the samples.
        """

    def rig_pose(
        self, views: Sequence[RigView], budget: RansacBudget, *, loss_scale_px: float
    ) -> Pose | None:
        """Return the `world_from_rig` with the most inliers among the points of all views, at least four, or None.

        The budget's inlier limit is that of the first view; those of the others are the same angle.
        """

    def relative_pose(
        self, pixels_a: Array, pixels_b: Array, cameras: tuple[Camera, Camera], budget: RansacBudget
    ) -> Pose | None:
        """Return the `b_from_a` with the most inliers among matched pixels (n, 2), (n, 2), n >= 8, or None.

        Its translation has length 1.
        """

    def upright_relative_poses(self, rays_a: Array, rays_b: Array) -> tuple[Array, Array]:
        """Return the turns (m,) in radians about +y and the translations (m, 3) of all poses that fit a sample exactly.

        A sample is three matches of unit rays (k, 3, 3), (k, 3, 3) in axes whose y is vertical. Translations have
        any length and either sign.
        """
