"""The features of a floor: stored in one form, whatever form they came in, and refused with a reason."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from app.engine.floors.collection import OPTIONS
from tests.plans import (
    GROUND,
    UPPER,
    add_floors,
    add_plans,
    area,
    collection,
    feature,
    landmark,
    link,
    put_features,
)
from tests.scenes import encode
from tests.server import Server, assert_problem, running

PATH = "/venues/site/floors/ground/features"


@pytest.fixture
def site(empty: Server) -> Server:
    """A server with a venue of two floors."""
    add_floors(empty)
    return empty


def stored(server: Server) -> list[dict[str, Any]]:
    answer = server.client.get(PATH)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/geo+json"
    return list(answer.json()["features"])


def test_features_come_and_are_replaced(site: Server) -> None:
    assert site.client.get(PATH).json() == collection()
    answer = put_features(site, "ground", GROUND)
    assert answer.status_code == 200
    assert answer.json() == {
        "venue": "site",
        "floor": "ground",
        "counts": {"landmark": 5, "poi": 1, "area": 3, "link": 5},
        "warnings": [
            "Link 'stairs-up' of floor 'ground' meets nothing on floor 'upper' yet.",
            "Link 'lift-up' of floor 'ground' meets nothing on floor 'upper' yet.",
        ],
    }
    kinds = {item["id"]: item["properties"]["kind"] for item in stored(site)}
    assert (kinds["kitchen"], kinds["stove"], kinds["hall"]) == ("area", "poi", "link")
    # Links between floors may come before what they lead to.
    assert put_features(site, "upper", UPPER).json()["warnings"] == []
    assert put_features(site, "ground", collection()).json()["counts"]["area"] == 0
    assert stored(site) == []


def test_what_get_returns_can_be_put_again(site: Server) -> None:
    put_features(site, "ground", GROUND)
    before = stored(site)
    assert put_features(site, "ground", site.client.get(PATH).json()).status_code == 200
    assert stored(site) == before


def test_a_changed_floor_keeps_its_features(site: Server) -> None:
    put_features(site, "ground", GROUND)
    before = stored(site)
    floor = {"name": "Other", "level": 0, "z_min_m": 0, "z_max_m": 2}
    assert site.client.put("/venues/site/floors/ground", json=floor).status_code == 200
    assert stored(site) == before


@pytest.mark.parametrize(
    ("properties", "mode"),
    [
        ({"kind": "link"}, "walk"),
        ({"kind": "link", "mode": "Walk"}, "walk"),
        ({"type": "link", "kind": "walk"}, "walk"),
        ({"kind": "link", "type": "corridor", "mode": "walk"}, "walk"),
        ({"kind": "walk"}, "walk"),
        ({"type": "link", "kind": "stairs", "to_floor": "upper"}, "stairs"),
        ({"type": "LINK", "link_kind": "elevator", "to_floor": "upper"}, "lift"),
        ({"kind": "escalator", "to_floor": "upper"}, "escalator"),
        ({"kind": "walk", "to_floor": "ground"}, "walk"),
    ],
    ids=str,
)
def test_every_way_to_say_what_a_link_is(site: Server, properties: dict[str, Any], mode: str) -> None:
    way = feature("LineString", [[0, 0], [5, 0]], id="way", **properties)
    answer = put_features(site, "ground", collection(way, landmark("a", 0, 0), landmark("b", 5, 0)))
    assert answer.status_code == 200, answer.text
    kept = stored(site)[0]["properties"]
    assert (kept["kind"], kept["mode"]) == ("link", mode)
    assert kept["accessible"] is (mode in ("walk", "lift"))


def test_ids_are_found_where_clients_put_them(site: Server) -> None:
    rooms = [{**area("x", 0, 0, 1, 1), "id": 7}, area("x", 2, 0, 3, 1), area("x", 4, 0, 5, 1)]
    for room in rooms:
        del room["properties"]["id"]
        room["properties"]["name"] = "Toilet"
    assert put_features(site, "ground", collection(*rooms)).status_code == 200
    assert [item["id"] for item in stored(site)] == ["7", "Toilet", "Toilet (2)"]


def test_longitude_and_latitude_become_plan_metres(site: Server) -> None:
    # One ten-thousandth of a degree at the equator: 11.13 m east, 11.06 m north.
    mark = landmark("a", 0.0001, 0.0001)
    origin = {"longitude": 0.0, "latitude": 0.0}
    assert put_features(site, "ground", collection(mark, origin=origin)).status_code == 200
    assert stored(site)[0]["geometry"]["coordinates"] == pytest.approx([11.132, 11.057], abs=1e-3)
    turned = {"lon": 0.0, "lat": 0.0, "rotation_deg": 90, "plan": [100, 50]}
    assert put_features(site, "ground", collection(mark, origin=turned)).status_code == 200
    assert stored(site)[0]["geometry"]["coordinates"] == pytest.approx([88.943, 61.132], abs=1e-3)
    # In metres now, and not to be converted once more.
    assert put_features(site, "ground", site.client.get(PATH).json()).status_code == 200
    assert stored(site)[0]["geometry"]["coordinates"] == pytest.approx([88.943, 61.132], abs=1e-3)


BOWTIE = feature("Polygon", [[[0, 0], [4, 4], [4, 0], [0, 4], [0, 0]]], kind="area", id="b", name="B")
A, B = landmark("a", 0, 0), landmark("b", 5, 0)
WALK = link((0, 0), (5, 0), id="way")
NAN, HUGE = float("nan"), 10**400
REFUSED: dict[str, tuple[object, str]] = {
    "no object": ([], "FeatureCollection"),
    "one feature": (A, "FeatureCollection"),
    "no list": ({"type": "FeatureCollection", "features": {}}, "list of features"),
    "a feature that is none": (collection(A, 5), "Feature 1:"),  # type: ignore[arg-type]
    "no properties": (collection({"type": "Feature"}), "Feature 0: it has no properties"),
    "no kind": (collection(feature("Point", [0, 0], name="x")), "must be one of landmark, poi, area, link"),
    "unknown kind": (collection(feature("Point", [0, 0], kind="door", id="d")), "not 'door'"),
    "unknown link": (collection(link((0, 0), (5, 0), type="link", kind="teleport")), "not 'teleport'"),
    "unknown mode": (collection(link((0, 0), (5, 0), mode=["walk"])), "mode must be one of"),
    "no name": (collection(feature("Point", [0, 0], kind="landmark", id="x")), "('x'): a landmark needs"),
    "empty name": (collection(area("x", 0, 0, 1, 1, name=" ")), "name must be a text"),
    "name is a number": (collection(area("x", 0, 0, 1, 1, name=5)), "name must be a text"),
    "surrogate": (b'{"type": "FeatureCollection", "features": [], "x": "\\ud800"}', "UTF-8"),
    "not UTF-8": (b"\xff\xfe\xfd", "UTF-8"),
    "not JSON": (b"{", "GeoJSON"),
    "NaN aside": (b'{"type": "FeatureCollection", "features": [], "x": NaN}', "finite"),
    "Infinity aside": (b'{"type": "FeatureCollection", "features": [], "x": 1e999}', "finite"),
    "nesting": (b"[" * 100_000, "nested"),
    "nested properties": (collection({**A, "x": json.loads("[" * 50 + "]" * 50)}), "nested"),
    "NaN": (collection(landmark("a", NAN, 0)), "finite"),
    "huge": (collection(landmark("a", HUGE, 0)), "a position is not finite"),
    "too far": (collection(landmark("a", 0, 1_000_001)), "within 1,000,000 m"),
    "text in a position": (collection(landmark("a", "0", 0)), "'0', which is not a number"),  # type: ignore[arg-type]
    "one number": (collection(feature("Point", [1], kind="poi", id="p", name="P")), "two numbers"),
    "no geometry": (collection({**A, "geometry": None}), "has no geometry"),
    "wrong geometry": (collection(feature("Point", [0, 0], kind="area", name="x")), "must be a Polygon"),
    "several polygons": (collection(feature("MultiPolygon", [], kind="area", name="x")), "must be a Polygon"),
    "area crosses itself": (collection(A, BOWTIE), "Feature 1 ('b'): the area intersects itself at (2, 2)"),
    "flat area": (collection(area("x", 0, 0, 5, 0)), "three different positions"),
    "degrees without origin": (collection(area("x", 2.1, 48.2, 2.1001, 48.2001)), "longitude and latitude"),
    "crs without origin": (
        collection(A, crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}),
        "add origin",
    ),
    "origin is text": (collection(A, origin="here"), "origin must be"),
    "origin on the pole": (collection(A, origin={"longitude": 0, "latitude": 90}), "89 degrees"),
    "origin without latitude": (collection(A, origin={"longitude": 0}), "latitude must be a number"),
    "origin with another turn": (
        collection(landmark("a", 2, 48), origin={"longitude": 2, "latitude": 48, "rotation": 30}),
        "no member 'rotation': it takes longitude, latitude, rotation_deg",
    ),
    "swapped": (collection(landmark("a", 48, 2), origin={"longitude": 2, "latitude": 48}), "swapped"),
    "the same id twice": (collection(A, landmark("a", 1, 1)), "Feature 1 ('a'): there is another landmark"),
    "no id": (collection({**A, "properties": {"kind": "landmark", "name": "A", "id": 1.5}}), "id must be"),
    "dangling": (collection(A, link((0, 0), (9, 0), id="w")), "Link 'w' dangles"),
    "dangling at 0.6 m": (collection(A, B, link((0, 0), (5, 0.6))), "Link 'link-2' dangles"),
    "alone": (collection(link((0, 0), (5, 0))), "dangles"),
    "point of a link": (collection(feature("Point", [0, 0], kind="link")), "must be a LineString"),
    "one position": (collection(feature("LineString", [[0, 0]], kind="link")), "two positions"),
    "no length": (collection(A, link((0, 0), (0, 0))), "shorter than"),
    "unknown landmark": (collection(A, B, link((0, 0), (5, 0), to="z")), "'z', which is no landmark"),
    "far from its landmark": (collection(A, B, link((0, 0), (5, 0), to="a")), "5.0 m away from 'a'"),
    "unknown floor": (collection(A, link((0, 0), (1, 0), mode="lift", to_floor="9")), "no floor '9'"),
    "own floor": (collection(A, link((0, 0), (1, 0), mode="lift", to_floor="ground")), "own floor"),
    "stairs to nowhere": (collection(A, link((0, 0), (1, 0), kind="stairs")), "needs to_floor"),
    "walk through the ceiling": (collection(A, B, link((0, 0), (5, 0), to_floor="upper")), "can't cross"),
    "accessible in words": (collection(A, B, {**WALK, "properties": {"kind": "walk", "accessible": "yes"}}), "'yes'"),
    "length below zero": (collection(A, link((0, 0), (1, 0), kind="lift", to_floor="upper", length_m=-1)), "length_m"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_features_that_can_not_be(site: Server, case: str) -> None:
    value, hint = REFUSED[case]
    put_features(site, "ground", GROUND)
    with site.unchanged():
        sentence = assert_problem(put_features(site, "ground", value), 422, "invalid_input")
    assert hint in sentence, sentence


def test_landmarks_in_degrees_are_refused_and_taken_with_an_origin(site: Server) -> None:
    marks = landmark("entrance", 13.37701, 52.51622), landmark("till", 13.37748, 52.5165)
    with site.unchanged():
        sentence = assert_problem(put_features(site, "ground", collection(*marks)), 422, "invalid_input")
    assert "Add origin" in sentence
    origin = {"longitude": 13.377, "latitude": 52.516}
    assert put_features(site, "ground", collection(*marks, origin=origin)).status_code == 200


def test_features_as_drawing_tools_write_them(site: Server) -> None:
    ring = [[0, 0], [10, 0], [10, 4], [0, 4], [0, 0]]
    hall = feature("MultiPolygon", [[ring]], kind="area", name="Hall")
    entrance = {**feature("Point", [0, 0], kind="landmark", name="Entrance", id=None), "id": "ent"}
    way = feature("MultiLineString", [[[0, 0], [8, 0]]], kind="link", id=None)
    drawn = collection(hall, entrance, landmark("till", 8, 0), way)
    assert put_features(site, "ground", drawn).status_code == 200
    assert stored(site)[0]["geometry"] == {"type": "Polygon", "coordinates": [ring]}
    found = site.client.get("/venues/site/route", params={"from": "ent", "to": "till"})
    assert found.status_code == 200, found.text
    assert found.json()["distance_m"] == 8.0


def test_features_in_pixels_of_the_plan_image_are_refused(site: Server) -> None:
    image = np.full((400, 600, 3), 255, dtype=np.uint8)
    sent = site.client.put(
        "/venues/site/floors/ground/plan",
        data={"meters_per_pixel": "0.02", "origin_px": "0,399"},
        files={"image": ("plan.png", encode(image, ".png"))},
    )
    assert sent.status_code == 200, sent.text
    in_pixels = collection(landmark("a", 150, 350), landmark("b", 550, 100))
    with site.unchanged():
        assert "pixels" in assert_problem(put_features(site, "ground", in_pixels), 422, "invalid_input")
    assert (
        put_features(site, "ground", collection(landmark("a", 3, 1), landmark("b", 11, 6))).status_code == 200
    )


def test_there_is_a_limit_for_features_and_positions(site: Server) -> None:
    many = collection(*[landmark("a", 0, 0)] * (OPTIONS.max_features + 1))
    line = link(*[(float(k), 0.0) for k in range(5001)])
    lines = [link(*[(float(k), 0.0) for k in range(4500)]) for _ in range(50)]
    with site.unchanged():
        assert "20,000 at most" in assert_problem(put_features(site, "ground", many), 422)
        assert "200,000 positions" in assert_problem(put_features(site, "ground", collection(*lines)), 422)
        assert "5,000 positions" in assert_problem(put_features(site, "ground", collection(line)), 422)


def test_long_texts_do_not_fill_the_answer(site: Server) -> None:
    long = "x" * 100_000
    for value in (collection(feature("Point", [0, 0], kind=long)), collection(landmark(long, 0, 0))):
        assert_problem(put_features(site, "ground", value), 422, "invalid_input")


def test_floors_and_venues_that_are_not_there(site: Server) -> None:
    assert_problem(put_features(site, "cellar", GROUND), 404, "not_found")
    assert_problem(put_features(site, "ground", GROUND, venue="none"), 404, "not_found")
    assert_problem(site.client.get("/venues/site/floors/cellar/features"), 404, "not_found")
    assert_problem(site.client.get("/venues/site/floors/-1/features"), 422)


def test_a_body_over_the_limit(tmp_path: Any) -> None:
    with running(tmp_path, run_worker=False) as server:
        add_floors(server)
        answer = server.client.put(
            PATH, content=b" " * 25_000_001, headers={"Content-Type": "application/geo+json"}
        )
        assert_problem(answer, 413, "upload_too_large")


def test_features_need_a_key(tmp_path: Any) -> None:
    with running(tmp_path, run_worker=False, admin_key="secret") as server:
        assert_problem(put_features(server, "ground", GROUND), 401, "unauthenticated")
        assert_problem(server.client.get(PATH), 401, "unauthenticated")


def test_features_survive_a_restart(tmp_path: Any) -> None:
    with running(tmp_path, run_worker=False) as server:
        add_plans(server)
        before = stored(server)
    with running(tmp_path, run_worker=False) as server:
        assert stored(server) == before
