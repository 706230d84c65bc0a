"""Where on Earth: origins of venues, GeoPoses of answers, and GeoJSON in longitude and latitude."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.engine.floors.earth import VenueOrigin
from app.geometry.geodesy import enu_from_geodetic
from app.geometry.se3 import Pose
from tests.api.test_anchor_sessions import follow
from tests.api.test_anchors import MONITOR, anchor_body, down, poi, push
from tests.api.test_locate import ORIGIN_PX, plan_from_world, put_floor
from tests.api.test_sessions import post, start
from tests.scenes import Room, View, encode, pose_at
from tests.server import Server, assert_problem, running

ORIGIN = {"latitude": 47.3782, "longitude": 8.5402, "height_m": 455.2, "heading_deg": 35.0, "floor": None}
AT = (ORIGIN["longitude"], ORIGIN["latitude"], ORIGIN["height_m"])
HEADING = np.radians(35.0)
# Plan x points 35 degrees right of east, plan y 35 degrees right of north.
EAST_NORTH_FROM_PLAN = np.array([[np.cos(HEADING), np.sin(HEADING)], [-np.sin(HEADING), np.cos(HEADING)]])
SQUARE = [[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0], [1.0, 1.0]]
FEATURES = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "id": "desk",
            "geometry": {"type": "Point", "coordinates": [2.0, 3.0]},
            "properties": {"kind": "landmark", "name": "Desk"},
        },
        {
            "type": "Feature",
            "id": "hall",
            # Clockwise: RFC 7946 wants the other way round.
            "geometry": {"type": "Polygon", "coordinates": [SQUARE[::-1]]},
            "properties": {"kind": "area", "name": "Hall"},
        },
    ],
}


def east_north(longitude_latitude: Any, height_m: float = 455.2) -> Any:
    """Return metres east and north of the origin."""
    points = np.array(longitude_latitude, dtype=float).reshape(-1, 2)
    return enu_from_geodetic(np.column_stack([points, np.full(len(points), height_m)]), AT)[:, :2]


def enu_of(geopose: dict[str, Any]) -> Any:
    """Return metres east, north and up of the origin."""
    position = geopose["position"]
    return enu_from_geodetic([[position["lon"], position["lat"], position["h"]]], AT)[0]


@pytest.fixture(scope="module")
def placed(museum: Server, scan_zip: bytes) -> Iterator[str]:
    """A venue with a map, a floor with a plan, and an origin."""
    venue = museum.add_venue("placed")
    assert museum.build(scan_zip, venue, gravity=[0, 0, -1])["state"] == "succeeded"
    put_floor(museum, venue, "ground", 0.0, 2.6, plan_from_world=plan_from_world())
    image = encode(np.full((300, 400, 3), 255, np.uint8), ".png")
    form = {"meters_per_pixel": "0.02", "origin_px": ",".join(map(str, ORIGIN_PX))}
    floor = f"/venues/{venue}/floors/ground"
    assert museum.client.put(f"{floor}/plan", data=form, files={"image": image}).status_code == 200
    assert museum.client.put(f"{floor}/features", json=FEATURES).status_code == 200
    assert museum.client.patch(f"/venues/{venue}", json={"origin": ORIGIN}).json()["origin"] == ORIGIN
    yield venue
    # Other tests ask the same server which venue is near.
    museum.client.delete(f"/venues/{venue}")


def test_an_origin_comes_changes_and_goes(empty: Server) -> None:
    client = empty.client
    own = {name: value for name, value in ORIGIN.items() if name != "floor"}
    created = client.post("/venues", json={"id": "a", "name": "A", "origin": own})
    assert created.json()["origin"] == ORIGIN
    assert client.post("/venues", json={"id": "b", "name": "B"}).json()["origin"] is None
    assert client.patch("/venues/a", json={"name": "New"}).json()["origin"] == ORIGIN
    moved = client.patch("/venues/a", json={"origin": {**own, "heading_deg": -90}}).json()
    assert (moved["name"], moved["origin"]["heading_deg"]) == ("New", -90)
    assert client.get("/venues/a").json() == moved
    assert [venue["origin"] for venue in client.get("/venues").json()] == [moved["origin"], None]
    assert client.patch("/venues/a", json={"origin": None}).json()["origin"] is None
    assert_problem(client.patch("/venues/none", json={"origin": ORIGIN}), 404, "not_found")


@pytest.mark.parametrize(
    "change",
    [
        {"latitude": 89.5},
        {"latitude": -91},
        {"latitude": "47"},
        {"latitude": True},
        {"longitude": 180.5},
        {"longitude": None},
        {"height_m": float("nan")},
        {"height_m": 1e6},
        {"heading_deg": float("inf")},
        {"heading_deg": 361},
        {"floor": "no floor"},
        {"elevation": 3},
    ],
    ids=str,
)
def test_origins_that_can_not_be(empty: Server, change: dict[str, object]) -> None:
    empty.add_venue("a")
    with empty.unchanged():
        # Not by `json=`, which refuses NaN: a client need not.
        content = json.dumps({"origin": {**ORIGIN, **change}})
        answer = empty.client.patch(
            "/venues/a", content=content, headers={"Content-Type": "application/json"}
        )
        sentence = assert_problem(answer, 422, "invalid_request")
    assert f"origin.{next(iter(change))}" in sentence


def test_a_change_says_something_and_names_a_floor_that_is_there(empty: Server) -> None:
    empty.add_venue("a")
    named = {"origin": {**ORIGIN, "floor": "attic"}}
    with empty.unchanged():
        assert "name, origin" in assert_problem(empty.client.patch("/venues/a", json={}), 422)
        assert_problem(empty.client.patch("/venues/a", json={"name": ""}), 422, "invalid_request")
        assert "'attic'" in assert_problem(empty.client.patch("/venues/a", json=named), 404, "not_found")
        body = {"id": "b", "name": "B", **named}
        assert_problem(empty.client.post("/venues", json=body), 404, "not_found")
    put_floor(empty, "a", "attic", 6, 9)
    assert empty.client.patch("/venues/a", json=named).json()["origin"]["floor"] == "attic"


def test_an_answer_says_where_on_earth(museum: Server, placed: str, queries: list[View]) -> None:
    result = museum.locate(queries[0].jpeg(), venue=placed)
    plan, geopose = result["plan"], result["geopose"]
    assert result["geopose_reason"] is None
    east, north, up = enu_of(geopose)
    # The plan point of the same answer is rounded to a tenth of a millimetre.
    assert [east, north] == pytest.approx(EAST_NORTH_FROM_PLAN @ [plan["x"], plan["y"]], abs=1e-4)
    assert up == pytest.approx(result["pose"]["position"]["z"], abs=1e-5)
    # A plan heading is counter-clockwise from plan x, yaw so from east.
    yaw = geopose["angles"]["yaw"]
    assert (plan["heading_deg"] - 35.0 - yaw + 180) % 360 - 180 == pytest.approx(0.0, abs=1e-2)
    q = geopose["quaternion"]
    body = Pose.from_quaternion([0, 0, 0], [q["x"], q["y"], q["z"], q["w"]]).rotation
    p = result["pose"]["quaternion"]
    camera = Pose.from_quaternion([0, 0, 0], [p["x"], p["y"], p["z"], p["w"]]).rotation
    # Up is up: the third rows of both rotations are the same directions, named by body and camera.
    assert body[2] == pytest.approx([camera[2, 2], -camera[2, 0], -camera[2, 1]], abs=1e-5)


def test_every_axes_has_the_same_geopose(museum: Server, placed: str, queries: list[View]) -> None:
    plain = museum.locate(queries[0].jpeg(), venue=placed)["geopose"]
    assert museum.locate(queries[0].jpeg(), venue=placed, axes="unreal")["geopose"] == plain


def test_a_frame_of_a_session_says_it_too(museum: Server, placed: str, queries: list[View]) -> None:
    frame = post(museum, start(museum, placed), queries[0].jpeg()).json()
    assert frame["located"]
    located = museum.locate(queries[0].jpeg(), venue=placed)
    assert enu_of(frame["geopose"]) == pytest.approx(enu_of(located["geopose"]), abs=0.05)
    lost = post(museum, start(museum, placed), encode(np.zeros((240, 320, 3), np.uint8), ".png")).json()
    assert (lost["located"], lost["geopose"], lost["geopose_reason"]) == (False, None, None)


def test_why_there_is_no_geopose(museum: Server, leaning: Server, placed: str, queries: list[View]) -> None:
    def why(server: Server, venue: str) -> Any:
        result = server.locate(queries[0].jpeg(), venue=venue)
        frame = post(server, start(server, venue), queries[0].jpeg()).json()
        assert result["located"]
        assert result["geopose"] is frame["geopose"] is None
        assert result["geopose_reason"] == frame["geopose_reason"]
        return result["geopose_reason"]

    assert why(museum, "museum") == "no_origin"
    leaning.client.patch("/venues/leaning", json={"origin": ORIGIN})
    assert why(leaning, "leaning") == "up_unknown"
    put_floor(museum, placed, "roof", 2.7, 5.0)
    museum.client.patch(f"/venues/{placed}", json={"origin": {**ORIGIN, "floor": "roof"}})
    assert why(museum, placed) == "plan_unknown"
    museum.client.delete(f"/venues/{placed}/floors/roof")
    assert why(museum, placed) == "plan_unknown"
    museum.client.patch(f"/venues/{placed}", json={"origin": ORIGIN})
    nothing = museum.locate(encode(np.zeros((240, 320, 3), np.uint8), ".png"), venue=placed)
    assert (nothing["located"], nothing["geopose"], nothing["geopose_reason"]) == (False, None, None)


@pytest.fixture
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, list[View]]]:
    """A server with a floor, a monitoring camera whose frame has come, an origin, and a phone's view."""
    room = Room(seed=5)
    phone = room.view(pose_at(1.7, 1.15, 1.4, 12.0, 2.0))
    with running(tmp_path_factory.mktemp("earth-anchors"), run_worker=False) as server:
        server.add_venue("v")
        put_floor(server, "v", "0", -1, 3)
        monitor = room.view(MONITOR)
        pois = [poi(monitor, 170, 110), poi(monitor, 90, 120, "left"), poi(monitor, 240, 130, "right")]
        assert server.client.put("/anchors/hall", json=anchor_body(monitor, pois=pois)).status_code == 200
        assert push(server, "hall", monitor.png()).status_code == 200
        assert server.client.patch("/venues/v", json={"origin": ORIGIN}).status_code == 200
        yield server, [phone]


def test_an_anchor_answers_where_on_earth_once_the_plan_is_placed(
    watched: tuple[Server, list[View]],
) -> None:
    server, (phone,) = watched
    given = {"venue": "v", "method": "anchor", "gravity": down(phone)}
    on_plan = server.locate(phone.jpeg(), **given)
    assert on_plan["plan"] is not None
    assert (on_plan["geopose"], on_plan["geopose_reason"]) == (None, "plan_unknown")
    put_floor(server, "v", "0", -1, 3, plan_from_world=np.eye(4).tolist())
    placed = server.locate(phone.jpeg(), **given)
    east_north_up = enu_of(placed["geopose"])
    plan = placed["plan"]
    assert east_north_up[:2] == pytest.approx(EAST_NORTH_FROM_PLAN @ [plan["x"], plan["y"]], abs=1e-4)
    assert placed["anchors"] == ["hall"]
    (frame,) = follow(server, [phone])
    assert frame["geopose"] is not None or frame["reason"] is not None


def test_features_in_degrees_and_back(museum: Server, placed: str) -> None:
    path = f"/venues/{placed}/floors/ground/features"
    answer = museum.client.get(path, params={"crs": "wgs84"})
    assert answer.headers["content-type"] == "application/geo+json"
    found = answer.json()
    point, area = (feature["geometry"]["coordinates"] for feature in found["features"])
    assert east_north(point)[0] == pytest.approx(EAST_NORTH_FROM_PLAN @ [2.0, 3.0], abs=1e-4)
    ring = east_north(area[0])
    expected = np.array(SQUARE) @ EAST_NORTH_FROM_PLAN.T
    assert min(np.abs(np.roll(ring[:-1], k, 0) - expected[:-1]).max() for k in range(4)) < 1e-4
    # Its properties are those of the plan's own GeoJSON, and it is read back as the same features.
    own = museum.client.get(path).json()
    assert [one["properties"] for one in found["features"]] == [one["properties"] for one in own["features"]]
    assert museum.client.put(path, json=found).status_code == 200
    back = museum.client.get(path).json()
    assert back["features"][0] == own["features"][0]
    assert museum.client.put(path, json=FEATURES).status_code == 200
    tag = answer.headers["etag"]
    again = museum.client.get(path, params={"crs": "wgs84"}, headers={"If-None-Match": tag})
    assert again.status_code == 304
    assert_problem(museum.client.get(path, params={"crs": "utm"}), 422, "invalid_request")


def test_a_venue_with_its_plans_in_degrees(museum: Server, placed: str) -> None:
    found = museum.client.get(f"/venues/{placed}/geojson").json()
    plan, desk, hall = found["features"]
    assert [one["properties"]["kind"] for one in (plan, desk, hall)] == ["plan", "landmark", "area"]
    assert {(one["properties"]["floor"], one["properties"]["level"]) for one in found["features"]} == {
        ("ground", 0)
    }
    # 400 x 300 pixels of 2 cm; the pixel of plan (0, 0) is (50, 250), and corners are half a pixel further out.
    upper_left, upper_right, lower_right, lower_left = (
        EAST_NORTH_FROM_PLAN @ corner
        for corner in ([-1.01, 5.01], [6.99, 5.01], [6.99, -0.99], [-1.01, -0.99])
    )
    corners = east_north(plan["properties"]["corners"])
    assert corners == pytest.approx(np.array([upper_left, upper_right, lower_right, lower_left]), abs=1e-4)
    ring = east_north(plan["geometry"]["coordinates"][0])
    assert np.linalg.det([ring[1] - ring[0], ring[2] - ring[1]]) > 0
    assert_problem(museum.client.get("/venues/museum/geojson"), 409, "conflict")
    assert_problem(museum.client.get("/venues/none/geojson"), 404, "not_found")


def test_floors_lie_above_each_other_by_their_transforms(empty: Server) -> None:
    empty.add_venue("a")
    turned = [[0, -1, 0, 10], [1, 0, 0, 4], [0, 0, 1, 0], [0, 0, 0, 1]]
    put_floor(empty, "a", "0", 0, 3, plan_from_world=np.eye(4).tolist())
    put_floor(empty, "a", "1", 3, 6, plan_from_world=turned)
    put_floor(empty, "a", "2", 6, 9)
    empty.client.patch("/venues/a", json={"origin": {**ORIGIN, "floor": "0"}})
    # World (2, 3) is (7, 6) on the plan of floor 1. Nothing is known of floor 2: its plan counts as that of floor 0.
    for floor, at in (("0", [2.0, 3.0]), ("1", [7.0, 6.0]), ("2", [2.0, 3.0])):
        one = {**FEATURES["features"][0], "geometry": {"type": "Point", "coordinates": at}}
        path = f"/venues/a/floors/{floor}/features"
        empty.client.put(path, json={**FEATURES, "features": [one]})
        found = empty.client.get(path, params={"crs": "wgs84"}).json()
        point = found["features"][0]["geometry"]["coordinates"]
        assert east_north(point)[0] == pytest.approx(EAST_NORTH_FROM_PLAN @ [2.0, 3.0], abs=1e-4)
        assert empty.client.put(path, json=found).status_code == 200
        back = empty.client.get(path).json()["features"][0]["geometry"]["coordinates"]
        assert back == pytest.approx(at, abs=1e-4)


def test_the_worked_example_of_the_heading() -> None:
    """A heading of 90 degrees: plan y points east, plan x south."""
    turn = VenueOrigin(latitude=0, longitude=0, height_m=0, heading_deg=90).enu_from_plan
    assert turn @ [0, 1, 0] == pytest.approx(np.array([1, 0, 0]))
    assert turn @ [1, 0, 0] == pytest.approx(np.array([0, -1, 0]))
