"""Where an answer lies: area and nearest landmark of its plan point, and searches that an area narrows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.plans import area, collection, feature, landmark, put_features
from tests.scenes import View
from tests.server import Server, assert_problem

SHIFT = np.array([100.0, 50.0])
HOUSE = "house"


@pytest.fixture(scope="module")
def house(museum: Server, scan_zip: bytes) -> Iterator[Server]:
    """The museum's server with a venue of a mapped floor, its meaning, and a floor without a plan."""
    museum.add_venue(HOUSE)
    museum.add_map(scan_zip, HOUSE, gravity=[0, 0, -1])
    x, y = SHIFT
    plan_from_world = [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]]
    heights = {"z_min_m": 0.0, "z_max_m": 2.6, "level": 0}
    for floor, more in (("0", {**heights, "plan_from_world": plan_from_world}), ("loft", {})):
        body = {"name": floor, "level": 1, "z_min_m": 3.0, "z_max_m": 5.0, **more}
        assert museum.client.put(f"/venues/{HOUSE}/floors/{floor}", json=body).status_code == 200
    ground = collection(
        area("room", x, y, x + 4, y + 3, name="Living room"),
        area("niche", x + 1, y + 1, x + 3, y + 2.5),
        area("garden", x + 40, y, x + 60, y + 10),
        landmark("sofa", x + 2, y + 1.5, "Sofa"),
        landmark("gate", x + 1.5, y - 0.5),
        feature("Point", [x + 1.5, y + 1.3], kind="poi", id="lamp", name="Lamp"),
    )
    assert put_features(museum, "0", ground, HOUSE).status_code == 200
    assert put_features(museum, "loft", collection(area("bed", 0, 0, 2, 2)), HOUSE).status_code == 200
    yield museum
    museum.client.delete(f"/venues/{HOUSE}")


def test_a_plan_point_says_its_area_and_nearest_landmark(house: Server, queries: list[View]) -> None:
    for query in queries:
        plan = house.locate(query.jpeg(), venue=HOUSE)["plan"]
        assert (plan["area"], plan["area_name"]) == ("niche", "Niche")
        assert (plan["nearest_landmark"], plan["nearest_landmark_name"]) == ("sofa", "Sofa")
        away_m = np.hypot(*(np.array([plan["x"], plan["y"]]) - SHIFT - [2, 1.5]))
        assert plan["nearest_landmark_m"] == pytest.approx(away_m, abs=0.002)


def test_operators_see_in_which_areas_pictures_are_refused(house: Server, queries: list[View]) -> None:
    house.locate(queries[0].jpeg(), venue=HOUSE)
    upside_down = house.locate(queries[0].jpeg(), venue=HOUSE, gravity="0,-1,0")
    assert (upside_down["located"], upside_down["reason"]) == (False, "ambiguous")
    text = house.client.get("/metrics").text
    for outcome in ("located", "ambiguous"):
        labels = f'area="niche",floor="0",outcome="{outcome}",venue="{HOUSE}"'
        assert f"roomfix_locate_area_total{{{labels}}}" in text


def test_other_features_count_at_once(house: Server, queries: list[View]) -> None:
    before = house.client.get(f"/venues/{HOUSE}/floors/0/features").json()
    put_features(house, "0", collection(landmark("door", *SHIFT)), HOUSE)
    plan = house.locate(queries[0].jpeg(), venue=HOUSE)["plan"]
    assert (plan["area"], plan["nearest_landmark"]) == (None, "door")
    put_features(house, "0", collection(), HOUSE)
    plan = house.locate(queries[0].jpeg(), venue=HOUSE)["plan"]
    assert (plan["area"], plan["nearest_landmark"], plan["nearest_landmark_m"]) == (None, None, None)
    put_features(house, "0", before, HOUSE)
    assert house.locate(queries[0].jpeg(), venue=HOUSE)["plan"]["area"] == "niche"


@pytest.mark.parametrize("name", ["room", "Living room", "LIVING ROOM"])
def test_an_area_narrows_the_search(house: Server, queries: list[View], name: str) -> None:
    for more in ({}, {"floor": "0"}):
        answer = house.locate(queries[0].jpeg(), venue=HOUSE, area=name, **more)
        assert (answer["located"], answer["narrowed"]) == (True, True)


@pytest.mark.parametrize("name", ["garden", "bed"])
def test_a_wrong_area_does_not_mislead(house: Server, queries: list[View], name: str) -> None:
    answer = house.locate(queries[0].jpeg(), venue=HOUSE, area=name)
    assert (answer["located"], answer["narrowed"], answer["plan"]["area"]) == (True, False, "niche")


def test_areas_that_are_not_there(house: Server, queries: list[View]) -> None:
    image = queries[0].jpeg()
    for fields in ({"area": "moon"}, {"area": "x" * 10_000}, {"area": "niche", "floor": "loft"}):
        sentence = assert_problem(house.post_image(image, {"venue": HOUSE, **fields}), 404, "not_found")
        assert "'bed'" in sentence
    assert_problem(house.post_image(image, {"venue": "museum", "area": "room"}), 404, "not_found")
