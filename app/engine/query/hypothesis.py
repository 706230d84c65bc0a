"""A pose that a query may have, with the matches that speak for it."""

from __future__ import annotations

from dataclasses import dataclass

from app.engine.query.matches import Matches
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A pose (`world_from_camera`), the matches that it was estimated from, those of them that agree with it, and of
    how many features of the query these are."""

    pose: Pose
    estimate: PnpEstimate
    matches: Matches
    inliers: Matches
    inlier_features: int

    @staticmethod
    def of(estimate: PnpEstimate, matches: Matches) -> Hypothesis:
        """Return the hypothesis of an estimate from matches."""
        inliers = matches.take(estimate.inlier_mask)
        return Hypothesis(estimate.world_from_camera, estimate, matches, inliers, inliers.feature_count)
