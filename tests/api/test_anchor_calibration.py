"""Calibration over HTTP: what it stores, and what it refuses rather than store a pose that is not sure."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.api.test_anchors import SHIFT, anchor_body
from tests.scenes import Room, View, encode, pose_at
from tests.server import Server, assert_problem, running


@cache
def monitor() -> View:
    """Return what the monitoring camera sees."""
    return Room(seed=1).view(pose_at(1.5, 1.35, 1.6, -20.0, -4.0))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with the room's map, and its floor on a plan."""
    matrix = np.eye(4)
    matrix[:2, 3] = SHIFT
    with running(tmp_path_factory.mktemp("calibration"), run_worker=False) as mapped:
        mapped.add_venue("v")
        floor = {"name": "G", "level": 0, "z_min_m": -1, "z_max_m": 3, "plan_from_world": matrix.tolist()}
        mapped.client.put("/venues/v/floors/0", json=floor)
        mapped.add_map(scan_zip, "v", gravity=[0, 0, -1])
        yield mapped


def entered(**changes: Any) -> dict[str, Any]:
    """Return the camera as an administrator enters it."""
    return anchor_body(monitor(), **changes)


def calibrate(server: Server, image: bytes) -> Any:
    return server.client.post("/anchors/hall/calibrate", content=image)


def test_a_calibration_says_where_the_camera_is_and_how_sure_that_is(server: Server) -> None:
    server.client.put("/anchors/hall", json=entered())
    answer = calibrate(server, monitor().png())
    assert answer.status_code == 200, answer.text
    calibration = answer.json()["calibration"]
    assert calibration["accuracy"]["position_m"] <= 0.05
    assert calibration["accuracy"]["orientation_deg"] <= 0.5
    assert calibration["inliers"] >= 50
    assert "points" not in calibration
    pushed = server.client.post("/anchors/hall/frames", content=monitor().png())
    assert pushed.status_code == 200, pushed.text
    assert server.client.get("/anchors/hall").json()["calibration"] == calibration


def test_a_camera_that_was_entered_elsewhere_is_not_calibrated(server: Server) -> None:
    body = entered()
    body["position"]["x"] += 2.5
    body["pois"][0]["position"]["x"] += 2.5
    server.client.put("/anchors/hall", json=body)
    with server.unchanged_rows():
        assert "2.5 m from where" in assert_problem(calibrate(server, monitor().png()), 409)


def test_a_poi_that_is_nowhere_near_contradicts_a_calibration(server: Server) -> None:
    body = entered()
    body["pois"][0]["position"]["y"] += 3.0
    body["pois"][0]["distance_m"] += 3.0
    server.client.put("/anchors/hall", json=body)
    with server.unchanged_rows():
        assert "POIs" in assert_problem(calibrate(server, monitor().png()), 409)


def test_a_camera_that_hangs_far_from_the_map_is_not_calibrated(server: Server) -> None:
    body = entered()
    body["position"]["x"] += 500.0
    body["pois"][0]["position"]["x"] += 500.0
    server.client.put("/anchors/hall", json=body)
    assert "no pictures from around" in assert_problem(calibrate(server, monitor().png()), 409)


@pytest.mark.parametrize("hidden", ["all but a corner", "all"])
def test_a_picture_that_shows_too_little_of_the_map_is_refused(server: Server, hidden: str) -> None:
    server.client.put("/anchors/hall", json=entered())
    image = np.full_like(monitor().rgb, 90)
    if hidden != "all":
        image[:80, :80] = monitor().rgb[:80, :80]
    with server.unchanged_rows():
        assert "could not be calibrated" in assert_problem(calibrate(server, encode(image, ".png")), 409)


def test_a_wrong_focal_length_is_refused(server: Server) -> None:
    body = entered()
    body["camera"] = {**body["camera"], "params": [400.0, 400.0, 159.5, 119.5]}
    server.client.put("/anchors/hall", json=body)
    with server.unchanged_rows():
        assert_problem(calibrate(server, monitor().png()), 409)
