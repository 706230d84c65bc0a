"""Networks and routes: lines that meet join, floors join by stairs and lifts, and no way is found where none is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.engine.floors.collection import parse_features
from app.engine.floors.floor import Floor
from app.engine.floors.places import PlaceIndex
from app.engine.navigation.language import Speaker, catalogues, language_of
from app.engine.navigation.model import Route
from app.engine.navigation.network import Network, build_network
from app.engine.navigation.places import NamedPlace, PlanPlace, parse_place
from app.engine.navigation.search import Limits, find_way
from app.engine.navigation.steps import make_route, turn_of
from app.errors import InvalidInputError, NoRouteError, NotFoundError, OffNetworkError
from tests.plans import GROUND, UPPER, area, collection, feature, landmark, link


def floor_of(floor_id: str, level: int, plan_from_world: Any = None) -> Floor:
    matrix = None if plan_from_world is None else np.array(plan_from_world, dtype=float)
    return Floor(
        venue_id="site",
        id=floor_id,
        name=f"{floor_id} floor".title(),
        level=level,
        z_min_m=0.0,
        z_max_m=3.0,
        plan_from_world=matrix,
        plan_residual_m=None,
        plan=None,
        features_sha256="x",
    )


def network_of(*collections: object, transforms: dict[str, Any] | None = None) -> Network:
    """Return the network of floors ground, upper, top with these features."""
    ids = ("ground", "upper", "top")
    floors = []
    for level, (floor_id, value) in enumerate(zip(ids, collections, strict=False)):
        features = parse_features(value, floor_id, ids)[1]
        floors.append((floor_of(floor_id, level, (transforms or {}).get(floor_id)), PlaceIndex(features)))
    return build_network(floors)


def route(network: Network, start: str, end: str, heading_deg: float | None = None, **limits: Any) -> Route:
    a, b = parse_place(start, network, "from"), parse_place(end, network, "to")
    chosen = Limits(frozenset(limits.get("avoid", ())), limits.get("accessible", False))
    return make_route(network, a, b, find_way(network, a, b, chosen), heading_deg)


@pytest.fixture(scope="module")
def site() -> Network:
    return network_of(GROUND, UPPER)


def turns(found: Route) -> list[str]:
    return [step.turn for step in found.steps]


def test_the_shortest_way_on_a_floor(site: Network) -> None:
    found = route(site, "kitchen-door", "desk")
    assert found.distance_m == pytest.approx(10.0)
    assert [p.landmark.id for p in found.passages] == ["kitchen-door", "office-door", "desk"]
    assert [(p.x, p.y) for p in found.points] == [(2, 1), (8, 1), (8, 5)]
    assert turns(found) == ["depart", "left", "arrive"]
    assert sum(step.distance_m for step in found.steps) == pytest.approx(found.distance_m)


def test_the_way_back_turns_the_other_way(site: Network) -> None:
    assert turns(route(site, "desk", "kitchen-door")) == ["depart", "right", "arrive"]


def test_floors_are_joined_by_stairs_and_lift(site: Network) -> None:
    # 16 m to the stairs, 10 m for them, 12 and 4 m above.
    assert route(site, "kitchen-door", "shelf").distance_m == pytest.approx(16 + 10 + 12 + 4)
    for limits in ({"avoid": ["stairs"]}, {"accessible": True}):
        by_lift = route(site, "kitchen-door", "shelf", **limits)
        # 18 m, one level by lift, 18 and 4 m.
        assert by_lift.distance_m == pytest.approx(18 + 15 + 18 + 4)
        assert "lift" in by_lift.modes
        assert "stairs" not in by_lift.modes
    down = route(site, "shelf", "kitchen-door")
    assert turns(down) == ["depart", "left", "down", "straight", "arrive"]
    with pytest.raises(NoRouteError, match=r"without lift and stairs.*only floor 'ground'.*there is one"):
        route(site, "kitchen-door", "shelf", avoid=["stairs", "lift"])


def test_stairs_and_lift_between_the_same_landmarks_are_kept_apart() -> None:
    ground = collection(
        landmark("core", 0, 0),
        feature("Point", [0, 0], kind="stairs", to_floor="upper", to="core"),
        feature("Point", [0, 0], kind="lift", to_floor="upper", to="core"),
    )
    network = network_of(ground, collection(landmark("core", 0, 0)))
    assert route(network, "ground:core", "upper:core").modes == ("stairs",)
    assert route(network, "ground:core", "upper:core", avoid=["stairs"]).modes == ("lift",)


def test_lines_that_cross_or_touch_join() -> None:
    marks = [landmark("a", 0, 0), landmark("b", 10, 0), landmark("c", 5, 5), landmark("d", 5, -5)]
    across = network_of(collection(*marks, link((0, 0), (10, 0)), link((5, 5), (5, -5))))
    assert route(across, "a", "c").distance_m == pytest.approx(10)
    # A T whose foot stops 0.3 m short, and a line drawn over another.
    marks = marks[:3]
    tee = network_of(collection(*marks, link((0, 0), (10, 0)), link((5, 5), (5, 0.3))))
    assert route(tee, "a", "c").distance_m == pytest.approx(10)
    over = network_of(
        collection(landmark("a", 0, 0), landmark("b", 10, 0), link((0, 0), (7, 0)), link((3, 0), (10, 0)))
    )
    assert route(over, "a", "b").distance_m == pytest.approx(10)


def test_a_line_that_crosses_itself_can_be_cut_short() -> None:
    loop = link((0, 0), (6, 0), (6, 4), (3, 4), (3, -4))
    network = network_of(collection(landmark("a", 0, 0), landmark("b", 3, -4), loop))
    assert route(network, "a", "b").distance_m == pytest.approx(7)


def test_lines_that_only_pass_near_each_other_do_not_join() -> None:
    marks = [landmark("a", 0, 0), landmark("b", 10, 0), landmark("c", 0, 0.7), landmark("d", 10, 0.7)]
    network = network_of(collection(*marks, link((0, 0), (10, 0)), link((0, 0.7), (10, 0.7))))
    with pytest.raises(NoRouteError, match="parts of floor 'ground' that no link joins"):
        route(network, "a", "d")


def test_a_landmark_beside_a_link_is_on_it() -> None:
    marks = [landmark("a", 0, 0), landmark("b", 10, 0), landmark("m", 5, 0.4)]
    network = network_of(collection(*marks, link((0, 0), (10, 0))))
    assert route(network, "a", "m").distance_m == pytest.approx(5.4)
    assert [p.landmark.id for p in route(network, "a", "b").passages] == ["a", "m", "b"]


def test_one_way_links() -> None:
    marks = [landmark("a", 0, 0), landmark("b", 10, 0)]
    way = link((0, 0), (10, 0), one_way=True)
    network = network_of(collection(*marks, way, link((0, 0), (0, 5), (10, 5), (10, 0))))
    assert route(network, "a", "b").distance_m == pytest.approx(10)
    assert route(network, "b", "a").distance_m == pytest.approx(20)
    assert route(network, "ground:7,0", "ground:3,0").distance_m == pytest.approx(3 + 20 + 3)
    assert route(network, "ground:3,0", "ground:7,0").distance_m == pytest.approx(4)


def test_plan_points_are_led_to_the_nearest_link(site: Network) -> None:
    found = route(site, "ground:5,0.2", "ground:8,3")
    assert found.distance_m == pytest.approx(0.8 + 3 + 2)
    on_one_link = route(site, "ground:10,1", "ground:12,1")
    assert on_one_link.distance_m == pytest.approx(2)
    with pytest.raises(
        OffNetworkError, match=r"within 10 m of \(5.00, 40.00\) on floor 'ground'; the nearest is 35"
    ):
        route(site, "ground:5,40", "desk")


def test_a_point_in_a_room_takes_the_link_of_that_room() -> None:
    # The corridor beyond the wall is nearer than the way through the room.
    rooms = [area("room", 0, 1, 10, 8), area("corridor", 0, -2, 10, 1)]
    marks = [landmark("in", 9, 7), landmark("out", 9, -1), landmark("w", 0, -1)]
    ways = [link((0, -1), (9, -1)), link((9, -1), (9, 7))]
    network = network_of(collection(*rooms, *marks, *ways))
    assert route(network, "ground:2,1.5", "in").distance_m == pytest.approx(7 + 5.5)


def test_a_poi_off_the_links_is_reached(site: Network) -> None:
    assert route(site, "kitchen-door", "stove").distance_m == pytest.approx(1 + 4)


def test_a_landmark_without_links_on_an_empty_floor() -> None:
    network = network_of(GROUND, collection(landmark("island", 0, 0)))
    with pytest.raises(NoRouteError, match="Floor 'upper' has no link"):
        route(network, "desk", "island")


def test_ways_that_arrive_nowhere_are_named() -> None:
    network = network_of(
        GROUND, collection(landmark("shelf", 2, 5), link((2, 5), (2, 1)), landmark("x", 2, 1))
    )
    assert [item.id for _, item in network.unmet] == ["stairs-up", "lift-up"]
    with pytest.raises(NoRouteError, match="'ground:stairs-up', 'ground:lift-up'"):
        route(network, "desk", "shelf")


def test_a_way_without_a_named_end_arrives_where_it_is_drawn() -> None:
    # The plan above is turned by a quarter and moved: the world joins both.
    turned = [[0, -1, 0, 50], [1, 0, 0, 20], [0, 0, 1, 0], [0, 0, 0, 1]]
    ground = collection(landmark("a", 0, 0), link((0, 0), (4, 0), kind="stairs", to_floor="upper"))
    upper = collection(landmark("b", 50, 30), landmark("s", 50, 24.5), link((50, 24.5), (50, 30)))
    network = network_of(ground, upper, transforms={"ground": np.eye(4), "upper": turned})
    assert route(network, "a", "b").distance_m == pytest.approx(10 + 5.5)


@pytest.mark.parametrize(
    ("text", "floor", "x"), [("ground:1,2", "ground", 1.0), (" upper: -1.5e1 , .5 ", "upper", -15.0)]
)
def test_points_as_text(site: Network, text: str, floor: str, x: float) -> None:
    place = parse_place(text, site, "from")
    assert isinstance(place, PlanPlace)
    assert (place.floor, place.x) == (floor, x)


def test_ids_as_text() -> None:
    network = network_of(
        collection(landmark("1,2", 0, 0), landmark("a:b", 1, 0)), collection(landmark("1,2", 0, 0))
    )
    place = parse_place("ground:1,2", network, "from")
    assert isinstance(place, NamedPlace)
    assert isinstance(parse_place("a:b", network, "from"), NamedPlace)
    with pytest.raises(InvalidInputError, match=r"several floors.*'ground:1,2', 'upper:1,2'"):
        parse_place("1,2", network, "from")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", InvalidInputError),
        ("  ", InvalidInputError),
        ("nobody", NotFoundError),
        ("cellar:1,2", NotFoundError),
        ("ground:nobody", NotFoundError),
        ("ground:1", NotFoundError),
        ("ground:1,2,3", NotFoundError),
        ("ground:nan,1", NotFoundError),
        ("ground:1e300,1", InvalidInputError),
        ("ground:1,-1e7", InvalidInputError),
    ],
)
def test_places_that_are_none(site: Network, text: str, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"^from"):
        parse_place(text, site, "from")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("book shelf", "did you mean 'shelf'"),
        ("DESK", "did you mean 'desk'"),
        ("upper:Book shelf", "did you mean 'shelf'"),
        ("library", "is an area"),
        ("14.0,17.0", "a point is floor:x,y"),
        ("ground:14,5,17,2", "a point is floor:x,y"),
        ("ground:14;17", "a point is floor:x,y"),
    ],
)
def test_what_was_probably_meant_is_named(site: Network, text: str, words: str) -> None:
    with pytest.raises(NotFoundError, match=words):
        parse_place(text, site, "from")


@pytest.mark.parametrize(
    ("angle_deg", "turn"),
    [
        (0, "straight"), (29, "straight"), (45, "slight_left"), (-45, "slight_right"), (90, "left"), (-90, "right"),
        (135, "sharp_left"), (-135, "sharp_right"), (170, "u_turn"), (-180, "u_turn"),
    ],
)  # fmt: skip
def test_turns_by_angle(angle_deg: float, turn: str) -> None:
    assert turn_of(angle_deg) == turn


@pytest.mark.parametrize(
    ("heading_deg", "turn"),
    [(0, "straight"), (90, "right"), (-90, "left"), (180, "u_turn"), (315, "slight_left")],
)
def test_the_first_turn_starts_from_the_heading(site: Network, heading_deg: float, turn: str) -> None:
    assert route(site, "kitchen-door", "desk", heading_deg).steps[0].turn == turn


def test_small_bends_are_no_turns() -> None:
    bends = [(k * 0.5, 0.2 * (k % 2)) for k in range(21)]
    round_table = [(10.0, 0.0), (12, 0), (13, 1), (14, 1), (15, 0), (20, 0)]
    network = network_of(collection(landmark("a", 0, 0), landmark("b", 20, 0), link(*bends, *round_table)))
    assert turns(route(network, "a", "b")) == ["depart", "arrive"]


def test_start_and_end_are_the_same(site: Network) -> None:
    found = route(site, "desk", "desk")
    assert (found.distance_m, turns(found)) == (0.0, ["arrive"])
    assert route(site, "ground:8,3", "ground:8,3").distance_m == 0


def spoken(found: Route, language: str) -> list[str]:
    speaker = Speaker(language, found.floor_names)
    return [speaker.step(step) for step in found.steps]


def test_steps_in_english(site: Network) -> None:
    assert spoken(route(site, "desk", "shelf"), "en") == [
        "Walk 4 m towards Office-Door.",
        "Turn left at Office-Door and walk 10 m towards Stairs.",
        "Take the stairs up to Upper Floor.",
        "On Upper Floor, walk 12 m.",
        "Turn right and walk 4 m towards Book shelf.",
        "You have arrived at Book shelf.",
    ]


def test_steps_in_german(site: Network) -> None:
    assert spoken(route(site, "shelf", "desk", avoid=["stairs"]), "de") == [
        "Gehen Sie 4 m.",
        "Biegen Sie links ab und gehen Sie 18 m in Richtung Lift, vorbei an Stairs.",
        "Fahren Sie mit dem Aufzug hinunter: Ground Floor.",
        "Ground Floor: Gehen Sie 12 m in Richtung Office-Door, vorbei an Stairs.",
        "Biegen Sie bei Office-Door rechts ab und gehen Sie 4 m in Richtung Desk.",
        "Sie haben Ihr Ziel erreicht: Desk.",
    ]


def test_names_with_braces_are_said_as_they_are() -> None:
    network = network_of(
        collection(landmark("a", 0, 0), landmark("b", 5, 0, "{0} {at}"), link((0, 0), (5, 0)))
    )
    assert spoken(route(network, "a", "b"), "en")[0] == "Walk 5 m towards {0} {at}."


def test_every_language_says_the_same_things() -> None:
    english = catalogues()["en"]
    for sentences in catalogues().values():
        assert sentences.keys() == english.keys()
        for key, text in sentences.items():
            values = dict.fromkeys(("at", "distance", "towards", "floor", "turn", "sentence", "names"), "X")
            text.format(first="X", second="X", metres=1, **values)
            # The same values appear.
            assert sorted(part.split("}")[0] for part in text.split("{")[1:]) == sorted(
                part.split("}")[0] for part in english[key].split("{")[1:]
            ), key


@pytest.mark.parametrize(
    ("asked", "accepted", "language"),
    [
        (None, None, "en"),
        ("de", "en", "de"),
        ("de-AT", None, "de"),
        ("DE_ch", None, "de"),
        (None, "fr, de;q=0.5, en;q=0.2", "de"),
        (None, "de;q=zero, en;q=0.1", "en"),
        (None, "*", "en"),
        (None, "fr, de;q=0", "en"),
        (None, "de;Q=0.1, en;Q=0.2", "en"),
        (" ", "de", "de"),
    ],
)
def test_languages(asked: str | None, accepted: str | None, language: str) -> None:
    assert language_of(asked, accepted) == language


def test_a_language_that_is_not_spoken() -> None:
    with pytest.raises(InvalidInputError, match="'de', 'en'"):
        language_of("tlh")
