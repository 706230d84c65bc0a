"""Whether somebody can be on another floor by now: as far as the next stairs, and the stairs, can be walked."""

from __future__ import annotations

import pytest

from app.engine.navigation.floor_changes import OPTIONS, can_have_changed_floor
from app.engine.navigation.places import PlanPlace
from tests.engine.navigation.test_navigation import network_of
from tests.plans import GROUND, UPPER, collection, landmark

# In tests.plans the stairs begin 16 m along the way from the kitchen door, at (18, 1), and count for 10 m.
STAIRS = PlanPlace("ground", 18.0, 1.0)


def seconds(metres: float) -> float:
    return (metres - OPTIONS.slack_m) / OPTIONS.pace_m_s


@pytest.mark.parametrize(
    ("place", "metres"),
    [(STAIRS, 10.0), (PlanPlace("ground", 12.0, 1.0), 16.0), (PlanPlace("upper", 14.0, 1.0), 10.0)],
)
def test_stairs_take_their_time(place: PlanPlace, metres: float) -> None:
    site = network_of(GROUND, UPPER)
    assert not can_have_changed_floor(site, place, seconds(metres - 0.1))
    assert can_have_changed_floor(site, place, seconds(metres + 0.1))


def test_one_floor_is_never_left() -> None:
    assert not can_have_changed_floor(
        network_of(collection(landmark("a", 1, 1))), PlanPlace("ground", 1, 1), 1e6
    )


def test_without_links_between_floors_nobody_knows_where_the_stairs_are() -> None:
    floors = network_of(collection(landmark("a", 1, 1)), collection(landmark("b", 1, 1)))
    here = PlanPlace("ground", 1, 1)
    assert not can_have_changed_floor(floors, here, 2.0)
    assert can_have_changed_floor(floors, here, 10.0)
