"""Monitoring cameras on a floor with areas: a phone that sees no POI is placed by the floor and the walls."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from tests.api.test_anchors import SHIFT, down, push
from tests.plans import area, collection, put_features
from tests.scenes import Room, View, pose_at
from tests.server import Server, running

LENS = Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5))
MONITOR = pose_at(0.5, 1.5, 2.3, 0.0, -20.0)
# It looks to the right; the POI is at the left edge of the camera's picture.
PHONE = pose_at(1.2, 1.9, 1.5, -24.0, -10.0)
POI_PIXEL = (76, 240)
POI_HALF_PX = 40


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    """A server with a floor of one camera and no areas."""
    with running(tmp_path, run_worker=False) as running_server:
        running_server.add_venue("v")
        floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
        assert running_server.client.put("/venues/v/floors/0", json=floor).status_code == 200
        view = Room(seed=7).view(MONITOR, LENS)
        assert running_server.client.put("/anchors/hall", json=hall(view)).status_code == 200
        assert push(running_server, "hall", view.png()).status_code == 200
        yield running_server


def hall(view: View, height_m: float = MONITOR.translation[2]) -> dict[str, Any]:
    """Return the camera with its one POI, at a height on the plan's z axis."""
    u, v = POI_PIXEL
    in_camera = LENS.unproject(np.array([[u, v]]), np.array([view.depth_m[v, u]]))
    point, at = MONITOR.apply(in_camera)[0], MONITOR.translation
    x, y = at[:2] + SHIFT
    corners = [(u + POI_HALF_PX * a, v + POI_HALF_PX * b) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return {
        "venue": "v",
        "floor": "0",
        "position": {"x": x, "y": y},
        "height_m": float(height_m),
        "camera": {"model": LENS.model, "width": LENS.width, "height": LENS.height, "params": LENS.params},
        "pois": [
            {
                "id": "picture",
                "region_px": corners,
                "position": dict(zip("xy", point[:2] + SHIFT, strict=True)),
                "distance_m": float(np.linalg.norm(point - at)),
            }
        ],
    }


def put_room(server: Server, deep_m: float = 4.0) -> None:
    """Draw the room on the plan, or one of another depth."""
    x, y = SHIFT
    drawn = collection(area("room", x, y, x + deep_m, y + 3.0))
    assert put_features(server, "0", drawn, "v").status_code == 200


def ask(server: Server, pose: Pose = PHONE, *, with_gravity: bool = True) -> dict[str, Any]:
    """Ask where the phone is."""
    view = Room(seed=7).view(pose, LENS)
    gravity = {"gravity": down(view)} if with_gravity else {}
    camera = ",".join(str(value) for value in LENS.params)
    return server.locate(view.png(), venue="v", method="anchor", camera=camera, **gravity)


def off_m(found: dict[str, Any], pose: Pose = PHONE) -> float:
    """Return how far an answer is off on the plan."""
    x, y = pose.translation[:2] + SHIFT
    return float(np.hypot(found["plan"]["x"] - x, found["plan"]["y"] - y))


def test_walls_give_the_scale_to_a_phone_that_sees_no_poi(server: Server) -> None:
    assert not ask(server)["located"]
    put_room(server)
    found = ask(server)
    assert found["located"], found
    assert off_m(found) < 0.2
    assert 0.0 < found["accuracy"]["position_m"] < 0.5


def test_without_gravity_walls_say_nothing(server: Server) -> None:
    put_room(server)
    assert not ask(server, with_gravity=False)["located"]


def test_a_plan_that_is_not_the_room_places_nobody_elsewhere(server: Server) -> None:
    put_room(server, deep_m=11.0)
    found = ask(server)
    assert not found["located"] or off_m(found) < 3.0 * found["accuracy"]["position_m"]


@pytest.mark.parametrize("shift_m", [-1.4, 3.5])
def test_where_z_does_not_count_from_the_floor_the_pois_alone_are_asked(
    server: Server, shift_m: float
) -> None:
    put_room(server)
    view = Room(seed=7).view(MONITOR, LENS)
    floor = {"name": "Ground", "level": 0, "z_min_m": -3, "z_max_m": 9}
    assert server.client.put("/venues/v/floors/0", json=floor).status_code == 200
    body = hall(view, MONITOR.translation[2] + shift_m)
    assert server.client.put("/anchors/hall", json=body).status_code == 200
    assert push(server, "hall", view.png()).status_code == 200
    sees_poi = pose_at(1.2, 1.3, 1.5, 12.0, -10.0)
    found = ask(server, sees_poi)
    assert found["located"], found
    assert off_m(found, sees_poi) < 0.2
    assert not ask(server)["located"]
