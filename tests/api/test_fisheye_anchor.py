"""A monitoring camera with a fisheye lens: as an anchor with measured POIs, and calibrated in a map."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.geometry.camera import Camera
from tests.api.test_anchors import SHIFT
from tests.scenes import Room, View, pose_at
from tests.server import Server, running

# About 120 degrees across its picture.
FISHEYE = Camera("OPENCV_FISHEYE", 1280, 960, (600.0, 600.0, 637.0, 482.0, -0.02, 0.004, 0.0, 0.0))
PHONE_CAMERA = Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5))
BOUND_M = 0.15


@cache
def monitor() -> View:
    """Return what the monitoring camera sees."""
    return Room(seed=1).view(pose_at(1.3, 1.4, 2.0, -25.0, -12.0), FISHEYE)


@cache
def phones() -> list[View]:
    """Return what phones see that look into a corner: of a single wall two poses look alike."""
    room = Room(seed=1)
    poses = pose_at(1.6, 1.6, 1.4, -35.0, 0.0), pose_at(1.8, 1.9, 1.6, -40.0, -4.0)
    return [room.view(pose, PHONE_CAMERA) for pose in poses]


def fisheye_body() -> dict[str, Any]:
    """Return the camera with two POIs, by the world points that their regions' middles show."""
    at = monitor().world_from_camera.translation
    return {
        "venue": "v",
        "floor": "0",
        "position": dict(zip("xy", (at[:2] + SHIFT).tolist(), strict=True)),
        "height_m": float(at[2]),
        "camera": {"model": FISHEYE.model, "width": 1280, "height": 960, "params": list(FISHEYE.params)},
        "pois": [poi("left", 480, 440), poi("right", 800, 490)],
    }


def poi(name: str, u: int, v: int, half: int = 90) -> dict[str, Any]:
    """Return a POI at a pixel."""
    ray = FISHEYE.unproject(np.array([[u, v]]), np.array([monitor().depth_m[v, u]]))
    point = monitor().world_from_camera.apply(ray)[0]
    return {
        "id": name,
        "region_px": [[u - half, v - half], [u + half, v - half], [u + half, v + half], [u - half, v + half]],
        "position": dict(zip("xy", (point[:2] + SHIFT).tolist(), strict=True)),
        "distance_m": float(np.linalg.norm(point - monitor().world_from_camera.translation)),
    }


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with the room's map."""
    with running(_folder(tmp_path_factory), run_worker=False) as mapped:
        mapped.add_venue("v")
        matrix = np.eye(4)
        matrix[:2, 3] = SHIFT
        floor = {"name": "G", "level": 0, "z_min_m": -1, "z_max_m": 3, "plan_from_world": matrix.tolist()}
        mapped.client.put("/venues/v/floors/0", json=floor)
        mapped.add_map(scan_zip, "v", gravity=[0, 0, -1])
        yield mapped


def _folder(factory: pytest.TempPathFactory) -> Path:
    return factory.mktemp("fisheye")


def error_m(server: Server, phone: View) -> float:
    """Return how far off a phone is put."""
    down = phone.world_from_camera.rotation.T @ [0.0, 0.0, -1.0]
    gravity = ",".join(f"{value:.4f}" for value in down)
    camera = ",".join(f"{value:g}" for value in PHONE_CAMERA.params)
    found = server.locate(phone.png(), venue="v", method="anchor", gravity=gravity, camera=camera)
    assert found["located"], found
    at = np.array([found["plan"]["x"], found["plan"]["y"]]) - SHIFT
    return float(np.linalg.norm(at - phone.world_from_camera.translation[:2]))


def test_a_fisheye_camera_locates_phones_and_is_calibrated(server: Server) -> None:
    assert server.client.put("/anchors/fish", json=fisheye_body()).status_code == 200
    pushed = server.client.post("/anchors/fish/frames", content=monitor().png()).json()
    assert set(pushed["pois_visible"]) == {"left", "right"}
    for phone in phones():
        assert error_m(server, phone) < BOUND_M
    answer = server.client.post("/anchors/fish/calibrate", content=monitor().png())
    assert answer.status_code == 200, answer.text
    calibration = answer.json()["calibration"]
    position = np.array([calibration["pose"]["position"][axis] for axis in "xyz"])
    assert np.linalg.norm(position - monitor().world_from_camera.translation) < 0.05
    assert calibration["accuracy"]["position_m"] <= 0.05
    assert calibration["accuracy"]["orientation_deg"] <= 0.5
    assert "points" not in calibration
    for phone in phones():
        assert error_m(server, phone) < BOUND_M
