"""Whether the place that the particles have may be answered: they only spread by errors that odometry knows of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.query.placed import Accuracy
from app.engine.tracking.fix import confidence_of_sigma
from app.engine.tracking.plan_walk.particles import PlanBelief
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustOptions:
    """When a place is lost, and when it is found again without a fix."""

    max_unseen_s: float = limit(
        1.0,
        "Time without a step that is seen after which the place is lost.",
        chosen="By hand: a quarter turn.",
    )
    min_confidence: float = limit(
        0.05,
        "Least confidence of a place that is answered.",
        chosen="A recorded walk of roomfix simulate --no-map --seed 5 (trip 2): of 190 places the 21 below it had a "
        "mean error of 1.2 m, the others of 0.28 m.",
    )
    refound_sigma_m: float = limit(
        0.5,
        "Position sigma at which walls have found a lost place again.",
        chosen="By hand: the error that counts as right.",
    )
    refound_sigma_deg: float = limit(
        10.0, "The same of the heading.", chosen="By hand: an arrow that is right."
    )
    max_sigma_m: float = limit(
        2.0, "Position sigma above which no place is answered.", chosen="By hand: half a room."
    )
    min_floor_share: float = limit(
        0.95,
        "Probability of a floor below which no place is answered: half way up the stairs.",
        chosen="By hand: a wrong floor is worse than none, and nobody needs an arrow on stairs.",
    )


OPTIONS = TrustOptions()


class PlaceTrust:
    """Follows whether a place is lost: `is_lost` until a fix, or the walls, have found it again.

    It `is_by_one_fix` while a second fix has to confirm it.
    """

    def __init__(self) -> None:
        self.is_lost = False
        self.is_by_one_fix = False

    def begun(self) -> None:
        """Note that a place is by one fix alone: it may be one that looks alike."""
        self.is_lost = self.is_by_one_fix = True

    def found(self) -> None:
        """Note that a fix is believed."""
        self.is_lost = self.is_by_one_fix = False

    def moved(self, unseen_s: float) -> None:
        """Note a step, after a time in which none was seen."""
        self.is_lost = self.is_lost or unseen_s > OPTIONS.max_unseen_s

    def is_known(self, belief: PlanBelief, accuracy: Accuracy) -> bool:
        """Whether a place is known well enough to say what the camera may see."""
        return (
            not self.is_lost
            and belief.position_sigma_m <= OPTIONS.max_sigma_m
            and confidence_of_sigma(accuracy) >= OPTIONS.min_confidence
        )

    def may_answer(self, belief: PlanBelief, accuracy: Accuracy) -> bool:
        """Whether a place may be answered."""
        if self.is_lost and not self.is_by_one_fix:
            is_narrow = belief.position_sigma_m <= OPTIONS.refound_sigma_m
            is_turned = np.degrees(belief.yaw_sigma_rad) > OPTIONS.refound_sigma_deg
            self.is_lost = is_turned or not is_narrow
        return self.is_known(belief, accuracy) and belief.floor_share >= OPTIONS.min_floor_share
