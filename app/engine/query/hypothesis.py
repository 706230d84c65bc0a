"""A pose that a query may have: found by its matches with a map, with those of them that speak for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.query.matches import Matches
from app.geometry.pnp import PnpEstimate
from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """From how far aside a feature is still recognised."""

    max_turn_cosine: float = limit(
        0.17,
        "Cosine of the largest angle between two rays to a point at which its feature is still matched.",
        chosen="By hand: 80 degrees, beyond which a wall shows nothing and a mirror image begins.",
    )


VIEW = ViewOptions()


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


def seen_from_one_side(
    points: NDArray[np.float64],
    keyframe_centres: NDArray[np.float32] | NDArray[np.float64],
    centre: NDArray[np.float64],
    min_cosine: float = VIEW.max_turn_cosine,
) -> NDArray[np.bool_]:
    """Return which points (n, 3) a camera at `centre` (3,) sees from the side that their keyframes, at (n, 3), saw
    them from, or one keyframe at (3,): by default within `max_turn_cosine`, beyond which no feature is matched."""
    a, b = points - keyframe_centres, points - centre
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.einsum("ij,ij->i", a, b) > min_cosine * lengths)
