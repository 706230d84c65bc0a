"""Simulated navigation: the walker's own doing, judged with guidance that knows the true place."""

from __future__ import annotations

import dataclasses
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.floors.floor import Floor
from app.engine.navigation.guidance import guide
from app.engine.navigation.model import Route
from app.engine.navigation.places import PlanPlace
from app.errors import InvalidInputError
from app.geometry.plan import plan_position
from bench.simulation.log import WalkLog
from bench.simulation.summary import Setting, figures_of, interval_percent
from bench.simulation.trips import Trip, pairs_by_length, shuffled, spots_of
from bench.simulation.walker import Walker
from bench.simulation.walks import Answer, Outcome, Shot, walk_trip
from tests.engine.navigation.test_navigation import network_of, route
from tests.plans import GROUND, UPPER

FLOOR = Floor(
    venue_id="site",
    id="ground",
    name="Ground floor",
    level=0,
    z_min_m=-0.5,
    z_max_m=3.0,
    plan_from_world=np.eye(4),
    plan_residual_m=None,
    plan=None,
    features_sha256=None,
)


class Yard:
    """A place without walls but one, at x = `wall_m`, and without stairs but in `Stairwell`."""

    def __init__(self, wall_m: float = 100.0) -> None:
        self.wall_m = wall_m

    def is_free(self, x: float, _y: float, _floor: int) -> bool:
        return x < self.wall_m

    def floor_at(self, _x: float, _y: float, floor: int) -> int:
        return floor

    def ground_m(self, _x: float, _y: float, _floor: int) -> float:
        return 0.0

    def stairs_end(self, _x: float, _y: float, _up: bool) -> tuple[float, float] | None:
        return None

    def way_out(self, x: float, y: float, _floor: int) -> list[tuple[float, float]]:
        return [(x, y), (x, y + 1.0), (x, y + 3.0)]


class Stairwell(Yard):
    """Stairs from x = 9 up to x = 12 on the next floor."""

    def floor_at(self, x: float, _y: float, _floor: int) -> int:
        return int(x > 10.5)

    def stairs_end(self, x: float, _y: float, up: bool) -> tuple[float, float] | None:
        if up:
            return (12.5, 5.0) if 8.5 < x < 12.0 else None
        return (8.0, 5.0) if 8.5 < x < 12.5 else None


class KnowsAll:
    """Guidance by the true pose, `ahead_m` off along x; silent without a route."""

    def __init__(self, way: Route | None, ahead_m: float = 0.0) -> None:
        self.way = way
        self.ahead_m = ahead_m
        self.along_m = 0.0

    def begin(self, _destination: str) -> None:
        self.along_m = 0.0

    def ask(self, shot: Shot, _rng: np.random.Generator) -> Answer:
        if self.way is None:
            return Answer(None, None)
        x, y, heading_deg = plan_position(np.eye(4), shot.world_from_camera)
        told = guide(self.way, "ground", x + self.ahead_m, y, heading_deg, "en", self.along_m)
        if told.along_m is not None and not told.off_route:
            self.along_m = told.along_m
        return Answer({**asdict(told), "problem": None}, PlanPlace("ground", x + self.ahead_m, y))

    def end(self) -> None:
        pass


@pytest.fixture(scope="module")
def way() -> Route:
    """From the desk (8, 5) by the office door (8, 1) to the kitchen door (2, 1)."""
    return route(network_of(GROUND, UPPER), "desk", "kitchen-door")


@pytest.fixture(scope="module")
def trip(way: Route) -> Trip:
    end = PlanPlace("ground", 2.0, 1.0)
    return Trip(
        number=0,
        length_m=10.0,
        start=(8.0, 5.0, 0),
        heading_deg=90.0,
        destination="kitchen-door",
        route_m=way.distance_m,
        spots=spots_of(way),
        end=end,
    )


def walked(trip: Trip, navigator: KnowsAll, wall_m: float = 100.0) -> Outcome:
    return walk_trip(trip, Yard(wall_m), {0: FLOOR}, navigator, fps=4, seed=3)


def test_a_walker_who_is_told_right_arrives(way: Route, trip: Trip) -> None:
    found = walked(trip, KnowsAll(way))
    assert (found.end, found.passed, found.is_success) == ("arrived", len(trip.spots), True)
    assert [spot.name for spot in trip.spots].count("office-door") == 1
    assert 0.7 * way.distance_m < found.walked_m < 1.5 * way.distance_m
    assert (found.mean_error_m, found.told_percent) == (0.0, 100.0)
    assert found == walked(trip, KnowsAll(way))


def test_who_is_told_wrong_does_not_count_as_arrived(way: Route, trip: Trip) -> None:
    assert walked(trip, KnowsAll(way, ahead_m=-5.0)).end in ("arrived elsewhere", "gave up")
    unmet = replace(trip, spots=(*trip.spots, replace(trip.spots[0], place=PlanPlace("ground", 30.0, 30.0))))
    assert walked(unmet, KnowsAll(way)).end == "missed a landmark"


def test_who_is_told_nothing_looks_around_and_gives_up(trip: Trip) -> None:
    found = walked(trip, KnowsAll(None))
    assert (found.end, found.told_percent, found.mean_error_m) == ("lost", 0.0, None)
    assert found.walked_m < 18.0


def test_who_is_lost_goes_back_where_they_came_from() -> None:
    walker = Walker(building=Yard(), x=2.0, y=1.0, floor=0, heading_deg=0.0, rng=np.random.default_rng(0))
    ahead = {
        "turn": "straight",
        "off_route": False,
        "arrived": False,
        "bearing_deg": 0.0,
        "remaining_m": 20.0,
    }
    for _ in range(10):
        walker.follow(ahead, 0.5)
    there = walker.x
    for _ in range(40):
        walker.follow({"instruction": "Stand still.", "arrived": False, "problem": "lost"}, 0.5)
    assert walker.x < there - 0.5


def test_who_was_nowhere_yet_goes_out_by_the_door() -> None:
    walker = Walker(building=Yard(), x=2.0, y=1.0, floor=0, heading_deg=0.0, rng=np.random.default_rng(0))
    for _ in range(44):
        walker.follow(
            {"instruction": "Stand still.", "arrived": False, "problem": "lost", "go_on_m": None}, 0.5
        )
    assert walker.y > 2.5


def test_who_was_told_to_turn_turns_and_goes_on_unseen() -> None:
    walker = Walker(building=Yard(), x=2.0, y=1.0, floor=0, heading_deg=0.0, rng=np.random.default_rng(0))
    told = {"turn": "left", "off_route": False, "arrived": False, "bearing_deg": 90.0, "remaining_m": 20.0}
    walker.follow(told, 0.25)
    for _ in range(24):
        walker.follow({"arrived": False, "problem": "lost", "go_on_m": 2.0}, 0.25)
    # The turn is done and two metres are walked; then the walker looks around.
    assert walker.y == pytest.approx(3.0, abs=0.4)
    assert abs(walker.heading_deg - 90.0) > 20.0
    assert walker.walked_m < 2.6


def test_stairs_are_taken_without_an_arrow_and_without_a_word() -> None:
    walker = Walker(
        building=Stairwell(), x=8.7, y=5.0, floor=0, heading_deg=90.0, rng=np.random.default_rng(0)
    )
    told = {"turn": "up", "off_route": False, "arrived": False, "bearing_deg": None, "remaining_m": 20.0}
    walker.follow({**told, "problem": None}, 0.5)
    for _ in range(16):
        walker.follow(None, 0.5)
    assert walker.floor == 1
    assert walker.x > 11.5


def test_walls_stop_walkers(way: Route, trip: Trip) -> None:
    walker = Walker(
        building=Yard(wall_m=8.5), x=8.0, y=5.0, floor=0, heading_deg=0.0, rng=np.random.default_rng(0)
    )
    ahead = {**asdict(guide(way, "ground", 8.0, 5.0, 0.0)), "bearing_deg": 0.0}
    places = [place for _ in range(10) for place in walker.follow(ahead, 0.5)]
    assert max(x for x, _, _ in places) < 8.5
    assert walked(trip, KnowsAll(way), wall_m=8.5).is_success


def test_routes_are_chosen_by_length_and_seed(way: Route) -> None:
    routes = {("a", "b"): way, ("b", "c"): way}
    pairs = pairs_by_length(routes, [10.0])
    assert pairs == {10.0: [("a", "b"), ("b", "c")]}
    chosen = shuffled(pairs, 4, 1)
    assert chosen == shuffled(pairs, 4, 1)
    assert {pair for _, pair in chosen[:2]} == set(routes)
    with pytest.raises(InvalidInputError, match="the longest is 10 m"):
        pairs_by_length(routes, [10.0, 500.0])


def test_wrong_places_are_counted(way: Route, trip: Trip) -> None:
    assert walked(trip, KnowsAll(way)).wrong_frames == 0
    off = walked(trip, KnowsAll(way, ahead_m=0.6))
    assert off.wrong_frames == off.frames


def test_what_is_in_the_log_is_not_walked_again(way: Route, trip: Trip, tmp_path: Path) -> None:
    walk, found = {"trip": 3, "start": (1.0, 2.0, 0)}, walked(trip, KnowsAll(way))
    log = WalkLog(tmp_path / "walks.jsonl")
    assert log.get(walk) is None
    log.add(walk, found)
    again = WalkLog(tmp_path / "walks.jsonl")
    assert again.get(walk) == found
    assert again.get({**walk, "trip": 4}) is None
    (tmp_path / "other.jsonl").write_text('{"walk": {}}\n')
    with pytest.raises(InvalidInputError, match="Line 1"):
        WalkLog(tmp_path / "other.jsonl")


def test_figures(way: Route, trip: Trip) -> None:
    good = walked(trip, KnowsAll(way))
    bad = dataclasses.replace(good, length_m=20.0, end="gave up")
    by_length = figures_of(Setting("on", 4, 1.0), [good, good, bad])
    assert [(one.length_m, one.runs, one.success_percent) for one in by_length] == [
        (10.0, 2, 100.0),
        (20.0, 1, 0.0),
        (None, 3, 66.7),
    ]
    assert (by_length[-1].wrong_frames, by_length[-1].frames) == (0, 3 * good.frames)
    assert by_length[-1].ends == {"arrived": 2, "gave up": 1}
    # Clopper and Pearson's interval in closed form for no failure: (alpha / 2)^(1 / n).
    assert interval_percent(20, 20) == (round(100 * 0.025 ** (1 / 20), 1), 100.0)
