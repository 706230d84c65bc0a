"""When the place of the particles is answered, and when it is lost."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.query.placed import Accuracy
from app.engine.tracking.plan_walk.particles import PlanBelief
from app.engine.tracking.plan_walk.trust import OPTIONS, PlaceTrust


def belief(sigma_m: float, yaw_deg: float = 3.0, floor_share: float = 1.0) -> PlanBelief:
    """Return a belief with a sigma of place and heading."""
    return PlanBelief(
        floor="ground",
        floor_share=floor_share,
        xy=np.zeros(2),
        yaw_rad=0.0,
        position_sigma_m=sigma_m,
        yaw_sigma_rad=float(np.radians(yaw_deg)),
    )


def answers(trust: PlaceTrust, place: PlanBelief) -> bool:
    """Return whether a place is answered with its own accuracy."""
    return trust.may_answer(place, Accuracy(place.position_sigma_m, float(np.degrees(place.yaw_sigma_rad))))


@pytest.mark.parametrize(
    ("sigma_m", "yaw_deg", "floor_share", "expected"),
    [(0.3, 3.0, 1.0, True), (2.5, 3.0, 1.0, False), (0.3, 60.0, 1.0, False), (0.3, 3.0, 0.9, False)],
)
def test_what_is_known_too_little_is_not_answered(
    sigma_m: float, yaw_deg: float, floor_share: float, expected: bool
) -> None:
    assert answers(PlaceTrust(), belief(sigma_m, yaw_deg, floor_share)) is expected


def test_a_place_is_lost_without_seen_steps_until_a_fix() -> None:
    trust, place = PlaceTrust(), belief(OPTIONS.refound_sigma_m + 0.1)
    trust.moved(OPTIONS.max_unseen_s)
    assert answers(trust, place)
    trust.moved(OPTIONS.max_unseen_s + 0.25)
    assert not answers(trust, place)
    # Steps that are seen again say nothing of where it is.
    trust.moved(0.0)
    assert not answers(trust, place)
    assert not trust.is_known(place, Accuracy(place.position_sigma_m, 3.0))
    trust.found()
    assert answers(trust, place)


def test_walls_that_leave_one_place_find_it_again() -> None:
    trust = PlaceTrust()
    trust.moved(OPTIONS.max_unseen_s + 0.25)
    assert not answers(trust, belief(OPTIONS.refound_sigma_m + 0.1))
    assert not answers(trust, belief(0.1, OPTIONS.refound_sigma_deg + 1.0))
    assert answers(trust, belief(OPTIONS.refound_sigma_m - 0.1))


def test_a_place_by_one_fix_is_not_answered_however_narrow_it_is() -> None:
    trust, place = PlaceTrust(), belief(0.1)
    trust.begun()
    assert not answers(trust, place)
    trust.moved(0.0)
    assert not answers(trust, place)
    trust.found()
    assert answers(trust, place)
