"""Guidance along a route: the next step from wherever the walker is."""

from __future__ import annotations

import itertools

import pytest

from app.engine.navigation.guidance import Guidance, guide
from app.engine.navigation.model import Route
from tests.engine.navigation.test_navigation import network_of, route
from tests.plans import GROUND, UPPER, collection, landmark, link


@pytest.fixture(scope="module")
def way() -> Route:
    """From the desk (8, 5) by (8, 1) to the stairs (18, 1), up to (14, 1), by (2, 1) to the shelf (2, 5)."""
    return route(network_of(GROUND, UPPER), "desk", "shelf")


def says(found: Guidance) -> tuple[str, str]:
    return found.turn, found.instruction


def test_ahead_of_a_turn(way: Route) -> None:
    found = guide(way, "ground", 8.2, 4.5, heading_deg=-80)
    assert says(found) == ("left", "Walk 4 m towards Office-Door. Turn left at Office-Door.")
    assert (found.distance_m, found.remaining_m) == (pytest.approx(3.5), pytest.approx(39.5))
    assert (found.landmark, found.off_route, found.arrived) == ("office-door", False, False)


def test_at_a_turn(way: Route) -> None:
    assert says(guide(way, "ground", 8, 2.0)) == ("left", "Turn left at Office-Door.")


def test_facing_the_wrong_way(way: Route) -> None:
    assert says(guide(way, "ground", 12, 1, heading_deg=180)) == (
        "u_turn",
        "Turn around. Walk 6 m towards Stairs.",
    )
    assert guide(way, "ground", 12, 1, heading_deg=-90).turn == "left"
    assert guide(way, "ground", 12, 1, heading_deg=40).turn == "up"


def test_an_arrow_points_at_the_way_ahead(way: Route) -> None:
    assert guide(way, "ground", 12, 1, heading_deg=30).bearing_deg == pytest.approx(-30)
    assert guide(way, "ground", 12, 1.5, heading_deg=0).bearing_deg == pytest.approx(-22.6, abs=0.1)
    assert guide(way, "ground", 8, 1.5, heading_deg=-90).bearing_deg == pytest.approx(54.5, abs=0.1)
    assert guide(way, "ground", 12, 1).bearing_deg is None
    assert guide(way, "cellar", 12, 1, heading_deg=0).bearing_deg is None


def test_an_arrow_leads_to_a_dead_end_and_out_again() -> None:
    """The way goes to the shelf at the end of a stub and comes back beside it."""
    there = collection(
        landmark("a", 0, 0),
        landmark("b", 8, 0),
        landmark("shelf", 4, 3),
        link((0, 0), (3.9, 0), (4, 3), id="in"),
        link((4, 3), (4.2, 0), (8, 0), id="out"),
    )
    way = route(network_of(there), "a", "b")
    along_m, y = 0.0, 1.0
    for step in range(100):
        found = guide(way, "ground", 4.0, y, heading_deg=90, progress_m=along_m)
        assert found.along_m is not None
        along_m = max(along_m, found.along_m)
        assert found.bearing_deg is not None
        ahead = abs(found.bearing_deg) < 90
        assert ahead or step > 10
        y += 0.1 if ahead else -0.1
        if y < 0.2:
            break
    assert y < 0.2
    assert step < 60


def test_before_on_and_after_the_stairs(way: Route) -> None:
    assert says(guide(way, "ground", 17, 1)) == (
        "up",
        "Take the stairs up to Upper Floor.",
    )
    on_stairs = guide(way, "ground", 16, 1, progress_m=14.5)
    assert says(on_stairs) == ("up", "Take the stairs up to Upper Floor.")
    assert guide(way, "ground", 18, 1, heading_deg=0).bearing_deg is None
    # Seen on the upper floor before the stairs end there.
    still = guide(way, "upper", 17, 1)
    assert not still.off_route
    assert guide(way, "upper", 12, 1).turn == "right"


def test_left_the_route(way: Route) -> None:
    off = guide(way, "ground", 3, 6)
    assert off.off_route
    assert off.instruction == "You have left the route."
    assert off.remaining_m == pytest.approx(40.0)
    assert not guide(way, "ground", 10.9, 4.0).off_route
    nowhere = guide(way, "cellar", 0, 0)
    assert (nowhere.off_route, nowhere.distance_m, nowhere.remaining_m) == (True, None, None)


def test_arriving(way: Route) -> None:
    near = guide(way, "upper", 2, 2)
    assert says(near) == ("arrive", "Walk 3 m to Book shelf.")
    there = guide(way, "upper", 2.5, 4)
    assert says(there) == ("arrive", "You have arrived at Book shelf.")
    assert there.arrived
    assert not guide(way, "ground", 2, 5).arrived


def test_a_walker_whose_place_is_uncertain_must_come_closer_to_have_arrived(way: Route) -> None:
    sigmas_m = (0.0, 0.2, 0.3, 3.0)
    assert [guide(way, "upper", 2, 3.5, position_sigma_m=sigma_m).arrived for sigma_m in sigmas_m] == [
        True,
        True,
        False,
        False,
    ]
    assert guide(way, "upper", 2, 4.5, position_sigma_m=3.0).arrived


def test_in_german(way: Route) -> None:
    assert (
        guide(way, "upper", 2, 2, language="de").instruction == "Gehen Sie 3 m bis zu Ihrem Ziel: Book shelf."
    )


def test_where_the_way_comes_by_twice_the_progress_decides() -> None:
    hairpin = link((0, 0), (20, 0), (20, 0.2), (0, 0.2), one_way=True)
    network = network_of(collection(landmark("a", 0, -0.4), landmark("z", 0, 0.6), hairpin))
    loop = route(network, "a", "z")
    assert loop.distance_m == pytest.approx(40, abs=1.5)
    assert guide(loop, "ground", 10, 0.1).remaining_m > 25
    assert guide(loop, "ground", 10, 0.1, progress_m=28).remaining_m < 15


def test_the_rest_shrinks_along_the_whole_way(way: Route) -> None:
    rest = way.distance_m + 1e-6
    for a, b in itertools.pairwise(way.points):
        if a.floor != b.floor:
            continue
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            along = a.along_m + share * (b.along_m - a.along_m)
            found = guide(
                way, a.floor, a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), None, "en", along
            )
            assert found.remaining_m is not None
            assert found.remaining_m <= rest + 1e-6
            assert found.remaining_m == pytest.approx(way.distance_m - along, abs=0.6)
            assert not found.off_route
            rest = found.remaining_m
    assert rest == pytest.approx(0)
