"""Anchors over HTTP: cameras are put, push frames, locate phones; and everything that is refused."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.scenes import CAMERA, Room, View, pose_at, scan_files, walk, zipped
from tests.server import Server, assert_problem, running

MONITOR = pose_at(1.2, 1.5, 2.2, 0.0, -12.0)
PHONE = pose_at(1.7, 1.15, 1.4, 12.0, 2.0)
CAMERA_BODY = {
    "model": CAMERA.model,
    "width": CAMERA.width,
    "height": CAMERA.height,
    "params": list(CAMERA.params),
}
SHIFT = np.array([10.0, 20.0])


@pytest.fixture(scope="module")
def room() -> Room:
    """A room that no map holds."""
    return Room(seed=5)


@pytest.fixture(scope="module")
def monitor(room: Room) -> View:
    """What the monitoring camera sees."""
    return room.view(MONITOR)


@pytest.fixture(scope="module")
def phone(room: Room) -> View:
    """What a phone sees."""
    return room.view(PHONE)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue and a floor without a place in the world, and no map."""
    with running(tmp_path_factory.mktemp("anchors"), run_worker=False) as running_server:
        running_server.add_venue("v")
        floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
        assert running_server.client.put("/venues/v/floors/0", json=floor).status_code == 200
        yield running_server


def poi(view: View, u: int, v: int, name: str = "poi", half: int = 35) -> dict[str, Any]:
    """Return a POI at a pixel of a view, on a plan shifted against the room."""
    point_in_camera = CAMERA.unproject(np.array([[u, v]]), np.array([view.depth_m[v, u]]))
    point = view.world_from_camera.apply(point_in_camera)[0]
    x, y = point[:2] + SHIFT
    region = [[u - half, v - half], [u + half, v - half], [u + half, v + half], [u - half, v + half]]
    distance = float(np.linalg.norm(point - view.world_from_camera.translation))
    return {"id": name, "region_px": region, "position": {"x": x, "y": y}, "distance_m": distance}


def anchor_body(view: View, **changes: Any) -> dict[str, Any]:
    """Return a monitoring camera's body with one POI."""
    x, y = view.world_from_camera.translation[:2] + SHIFT
    return {
        "venue": "v",
        "floor": "0",
        "position": {"x": x, "y": y},
        "height_m": float(view.world_from_camera.translation[2]),
        "camera": CAMERA_BODY,
        "pois": [poi(view, 170, 110)],
        **changes,
    }


def push(server: Server, camera: str, image: bytes) -> Any:
    """Push a frame as a form field."""
    return server.client.post(f"/anchors/{camera}/frames", files={"image": ("frame.png", image)})


def down(view: View) -> str:
    """Return down in a view's camera axes, as the field gravity."""
    return ",".join(f"{value:.6f}" for value in view.world_from_camera.rotation.T @ [0, 0, -1])


def test_a_phone_is_located_by_a_camera_on_a_plan_without_a_map(
    server: Server, monitor: View, phone: View
) -> None:
    stored = server.client.put("/anchors/hall", json=anchor_body(monitor))
    assert stored.status_code == 200, stored.text
    assert stored.json()["frame"] is None
    pushed = push(server, "hall", monitor.png())
    assert pushed.status_code == 200, pushed.text
    assert pushed.json()["pois_visible"] == ["poi"]
    assert pushed.json()["features"] > 100
    found = server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone))
    assert found["located"], found
    assert found["method"] == "anchor"
    assert found["anchors"] == ["hall"]
    assert found["vertical"] == "gravity"
    assert found["pose"] is None
    assert found["floor"] == "0"
    x, y = PHONE.translation[:2] + SHIFT
    assert np.hypot(found["plan"]["x"] - x, found["plan"]["y"] - y) < 0.15
    assert abs(found["plan"]["heading_deg"] - 12.0) < 3.0
    assert 0.0 < found["accuracy"]["position_m"] < 0.5
    listed = server.client.get("/anchors/hall").json()
    assert listed["uses"] == 1
    assert listed["last_used_at"]
    assert listed["frame"]["fresh"]
    assert not listed["frame"]["image_stored"]
    assert [anchor["id"] for anchor in server.client.get("/anchors?venue=v").json()] == ["hall"]
    risk = str(0.9 * (1 - found["confidence"]))
    surer = server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone), max_risk=risk)
    assert (surer["located"], surer["reason"], surer["plan"]) == (False, "too_few_inliers", None)
    auto = server.locate(phone.png(), venue="v", gravity=down(phone))
    assert auto["located"]
    assert auto["method"] == "anchor"
    assert server.client.delete("/anchors/hall").status_code == 204
    assert_problem(server.client.get("/anchors/hall"), 404, "not_found")


def test_without_gravity_the_answer_says_so_and_claims_less(
    server: Server, monitor: View, phone: View
) -> None:
    server.client.put("/anchors/hall", json=anchor_body(monitor))
    push(server, "hall", monitor.png())
    with_gravity = server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone))
    without = server.locate(phone.png(), venue="v", method="anchor")
    assert without["located"]
    assert without["vertical"] == "upright"
    assert without["accuracy"]["position_m"] > with_gravity["accuracy"]["position_m"]


def test_a_floor_with_a_place_in_the_world_gives_a_pose(server: Server, monitor: View, phone: View) -> None:
    floor = {"name": "First", "level": 1, "z_min_m": -1, "z_max_m": 3}
    matrix = np.eye(4)
    matrix[:2, 3] = SHIFT
    server.client.put("/venues/v/floors/1", json={**floor, "plan_from_world": matrix.tolist()})
    server.client.put("/anchors/upstairs", json=anchor_body(monitor, floor="1"))
    push(server, "upstairs", monitor.png())
    found = server.locate(phone.png(), venue="v", floor="1", method="anchor", gravity=down(phone))
    assert found["located"]
    position = np.array([found["pose"]["position"][axis] for axis in "xyz"])
    assert np.linalg.norm(position - PHONE.translation) < 0.2
    server.client.delete("/anchors/upstairs")


def test_a_raw_body_is_a_frame_too_and_its_image_is_stored_on_demand(server: Server, monitor: View) -> None:
    server.client.put("/anchors/raw", json=anchor_body(monitor, store_images=True))
    answer = server.client.post(
        "/anchors/raw/frames", content=monitor.png(), headers={"Content-Type": "image/png"}
    )
    assert answer.status_code == 200, answer.text
    assert server.client.get("/anchors/raw").json()["frame"]["image_stored"]
    shown = server.client.get("/anchors/raw/picture")
    assert shown.headers["Content-Type"] == "image/jpeg"
    picture = np.asarray(Image.open(io.BytesIO(shown.content)), float)
    assert picture.shape == monitor.rgb.shape
    assert np.abs(picture - monitor.rgb).mean() < 12 < np.abs(picture - monitor.rgb[..., ::-1]).mean()
    before = {name for name in server.files() if "blobs" in name}
    server.client.post("/anchors/raw/frames", content=monitor.jpeg())
    after = {name for name in server.files() if "blobs" in name}
    assert len(after) == len(before)
    assert after != before
    server.client.put("/anchors/raw", json=anchor_body(monitor))
    server.client.post("/anchors/raw/frames", content=monitor.jpeg())
    sentence = assert_problem(server.client.get("/anchors/raw/picture"), 404)
    assert "store_images is false" in sentence
    server.client.delete("/anchors/raw")


def test_a_stale_frame_is_not_used(server: Server, monitor: View, phone: View) -> None:
    server.client.put("/anchors/hall", json=anchor_body(monitor, max_age_s=1e-6))
    push(server, "hall", monitor.png())
    found = server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone))
    assert not found["located"]
    assert found["reason"] == "no_map"
    assert not server.client.get("/anchors/hall").json()["frame"]["fresh"]
    server.client.delete("/anchors/hall")


def test_another_room_is_not_located(server: Server, monitor: View) -> None:
    server.client.put("/anchors/hall", json=anchor_body(monitor))
    push(server, "hall", monitor.png())
    stranger = Room(seed=77).view(PHONE)
    found = server.locate(stranger.png(), venue="v", method="anchor", gravity=down(stranger))
    assert not found["located"]
    assert found["plan"] is None
    assert found["anchors"] == []
    server.client.delete("/anchors/hall")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"pois": []}, "pois"),
        ({"height_m": 1e9}, "height_m"),
        ({"camera": "1,1,1"}, "camera"),
        ({"camera": None}, "camera"),
        ({"camera": {**CAMERA_BODY, "params": [0, 0, 0, 0]}}, "fx"),
        ({"max_age_s": 0}, "max_age_s"),
        ({"heading_deg": 180.0}, "behind"),
        ({"height_m": 2600}, "far from the heights -1 to 3"),
        ({"height_m": -60}, "far from the heights -1 to 3"),
        ({"camera": [[262, 0, 0], [0, 262, 0], [160, 3, 1.5]]}, "3x3 matrix"),
        ({"camera": "0.8,1.1,0.5,0.5"}, "shares"),
    ],
)
def test_a_bad_camera_is_refused(server: Server, monitor: View, change: dict[str, Any], word: str) -> None:
    with server.unchanged_rows():
        answer = server.client.put("/anchors/bad", json=anchor_body(monitor, **change))
        assert word in assert_problem(answer, 422)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"distance_m": 0.0}, "distance_m"),
        ({"distance_m": -3.0}, "distance_m"),
        ({"distance_m": 0.5}, "shorter"),
        ({"region_px": [[300, 200], [340, 200], [340, 239], [300, 239]]}, "outside"),
        ({"region_px": [[-40, 10], [10, 10], [10, 40]]}, "outside"),
        ({"region_px": [[10, 10], [11, 10], [11, 11]]}, "covers"),
        ({"region_px": [[10, 10], [40, 40]]}, "region_px"),
        ({"position": {"x": 11.2, "y": 21.5}}, "own position"),
        ({"distance_m": 250}, "above or below it. Give metres"),
        ({"distance_m": 9.0, "height_m": 1.5}, "by their places on the plan and their heights"),
        ({"region_px": [[10, 10], [90, 60], [90, 10], [10, 60]]}, "crosses itself"),
        ({"region_px": [[0.1, 0.2], [0.4, 0.2], [0.4, 0.5]]}, "shares of the image"),
    ],
)
def test_a_bad_poi_is_refused(server: Server, monitor: View, change: dict[str, Any], word: str) -> None:
    with server.unchanged_rows():
        body = anchor_body(monitor, pois=[{**poi(monitor, 170, 110), **change}])
        assert word in assert_problem(server.client.put("/anchors/bad", json=body), 422)


def test_a_region_may_be_closed_and_its_height_stated(server: Server, monitor: View) -> None:
    drawn = poi(monitor, 170, 110)
    region = [*drawn["region_px"], drawn["region_px"][0]]
    point = CAMERA.unproject(np.array([[170, 110]]), np.array([monitor.depth_m[110, 170]]))
    height_m = float(monitor.world_from_camera.apply(point)[0][2])
    for closed in (region, region[::-1]):
        body = anchor_body(monitor, pois=[{**drawn, "region_px": closed, "height_m": height_m}])
        answer = server.client.put("/anchors/closed", json=body)
        assert answer.status_code == 200, answer.text
    server.client.delete("/anchors/closed")


def test_a_camera_off_the_plan_image_is_refused(server: Server, monitor: View) -> None:
    floor = {"name": "Drawn", "level": 2, "z_min_m": 3, "z_max_m": 6}
    server.client.put("/venues/v/floors/2", json=floor)
    server.client.put(
        "/venues/v/floors/2/plan",
        data={"meters_per_pixel": "0.1", "origin_px": "0,99"},
        files={"image": ("plan.png", picture(100, 100))},
    )
    message = assert_problem(server.client.put("/anchors/bad", json=anchor_body(monitor, floor="2")), 422)
    assert "outside the plan image" in message


def test_places_that_are_not_there(server: Server, monitor: View) -> None:
    assert_problem(server.client.put("/anchors/bad", json=anchor_body(monitor, venue="nowhere")), 404)
    assert_problem(server.client.put("/anchors/bad", json=anchor_body(monitor, floor="99")), 404)
    assert_problem(push(server, "unknown", monitor.png()), 404, "not_found")
    assert_problem(server.client.delete("/anchors/unknown"), 404)
    assert_problem(server.client.post("/anchors/unknown/calibrate"), 404)
    assert_problem(server.client.put("/anchors/..%2fetc", json=anchor_body(monitor)), 404)


def test_frames_that_are_no_pictures_of_the_camera(server: Server, monitor: View) -> None:
    server.client.put("/anchors/hall", json=anchor_body(monitor))
    with server.unchanged_rows():
        assert_problem(push(server, "hall", b""), 422)
        assert_problem(push(server, "hall", b"hello" * 99), 415)
        assert_problem(push(server, "hall", monitor.png()[:2000]), 422)
        assert_problem(push(server, "hall", picture(1, 1)), 422)
        assert_problem(push(server, "hall", picture(10_000, 10_000)), 413)
        assert_problem(push(server, "hall", picture(300, 300)), 422, "invalid_camera")
        assert_problem(
            server.client.post("/anchors/hall/frames", data={"other": "x"}, files={"x": b"1"}), 422
        )
    server.client.delete("/anchors/hall")


def test_a_camera_without_a_size_gets_it_from_its_frames(server: Server, monitor: View) -> None:
    numbers = ",".join(f"{value:g}" for value in CAMERA.params)
    body = anchor_body(monitor, camera=numbers)
    assert server.client.put("/anchors/numbers", json=body).status_code == 200
    assert push(server, "numbers", monitor.png()).status_code == 200
    far = [[350, 20], [390, 20], [390, 60], [350, 60]]
    server.client.put("/anchors/numbers", json={**body, "pois": [{**body["pois"][0], "region_px": far}]})
    assert "outside the frame" in assert_problem(push(server, "numbers", monitor.png()), 422)
    server.client.delete("/anchors/numbers")


def test_the_method_needs_intrinsics(server: Server, phone: View) -> None:
    answer = server.post_image(phone.png(), {"venue": "v", "method": "anchor"})
    assert "camera" in assert_problem(answer, 422)


def test_calibration_needs_a_map(server: Server, monitor: View) -> None:
    server.client.put("/anchors/hall", json=anchor_body(monitor))
    answer = server.client.post("/anchors/hall/calibrate", content=monitor.png())
    assert "map" in assert_problem(answer, 409, "conflict")
    server.client.delete("/anchors/hall")


def test_a_venue_takes_its_anchors_along(server: Server, monitor: View) -> None:
    server.add_venue("gone")
    server.client.put("/venues/gone/floors/0", json={"name": "G", "level": 0, "z_min_m": 0, "z_max_m": 3})
    server.client.put("/anchors/gone", json=anchor_body(monitor, venue="gone"))
    assert_problem(server.client.put("/anchors/gone", json=anchor_body(monitor)), 409)
    server.client.delete("/venues/gone")
    assert_problem(server.client.get("/anchors/gone"), 404)


def test_calls_need_a_key(tmp_path: Path, monitor: View) -> None:
    with running(tmp_path, run_worker=False, admin_key="secret") as locked:
        assert_problem(locked.client.put("/anchors/hall", json=anchor_body(monitor)), 401)
        assert_problem(push(locked, "hall", monitor.png()), 401)
        assert_problem(locked.client.post("/anchors/hall/calibrate"), 401)
        assert_problem(locked.client.get("/anchors"), 401)


def test_a_map_tells_where_camera_and_pois_are(tmp_path: Path) -> None:
    room = Room(seed=1)
    views = [room.view(pose) for pose in walk()]
    monitor = room.view(pose_at(1.5, 1.35, 1.6, -20.0, -4.0))
    phone = room.view(pose_at(1.8, 1.3, 1.4, -12.0, 0.0))
    matrix = np.eye(4)
    matrix[:2, 3] = SHIFT
    with running(tmp_path, run_worker=False) as mapped:
        mapped.add_venue("v")
        floor = {"name": "G", "level": 0, "z_min_m": -1, "z_max_m": 3, "plan_from_world": matrix.tolist()}
        mapped.client.put("/venues/v/floors/0", json=floor)
        mapped.add_map(zipped(scan_files(views)), "v", gravity=[0, 0, -1])
        body = anchor_body(monitor)
        # Entered a metre off: the map knows better.
        body["position"]["x"] += 0.5
        assert mapped.client.put("/anchors/hall", json=body).status_code == 200
        assert_problem(mapped.client.post("/anchors/hall/calibrate"), 409)
        stranger = Room(seed=9).view(PHONE)
        assert_problem(mapped.client.post("/anchors/hall/calibrate", content=stranger.png()), 409)
        answer = mapped.client.post("/anchors/hall/calibrate", content=monitor.png())
        assert answer.status_code == 200, answer.text
        calibration = answer.json()["calibration"]
        position = np.array([calibration["pose"]["position"][axis] for axis in "xyz"])
        assert np.linalg.norm(position - monitor.world_from_camera.translation) < 0.05
        place = calibration["pois"][0]
        assert abs(place["distance_m"] - body["pois"][0]["distance_m"]) < 0.15
        assert answer.json()["frame"]["fresh"]
        found = mapped.locate(phone.png(), venue="v", method="anchor")
        assert found["located"], found
        assert found["vertical"] == "map"
        located = np.array([found["pose"]["position"][axis] for axis in "xyz"])
        assert np.linalg.norm(located - phone.world_from_camera.translation) < 0.15


def picture(width: int, height: int) -> bytes:
    """Return a grey PNG file of that size."""
    buffer = io.BytesIO()
    Image.new("L", (width, height), 128).save(buffer, "PNG")
    return buffer.getvalue()
