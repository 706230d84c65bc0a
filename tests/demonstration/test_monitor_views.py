"""Sampled monitoring cameras and phones obey the protocol."""

from __future__ import annotations

import numpy as np
import pytest

from app.demonstration.decor import wall_prints
from app.demonstration.layout import room_by_id
from app.demonstration.monitor_views import MIN_POIS, sample_view
from app.demonstration.monitors import MONITOR_CAMERA
from app.demonstration.queries import PHONE_CAMERA

pytest.importorskip("embreex")


def test_camera_and_phone_see_the_same_print_from_the_same_room() -> None:
    from app.demonstration.scene import demo_scene

    room = room_by_id("0-lobby")
    rng = np.random.default_rng(3)
    view = sample_view(rng, demo_scene(), room, (MONITOR_CAMERA, PHONE_CAMERA), (10.0, 30.0), (2.0, 6.0))
    assert view is not None
    assert len(view.pois) >= MIN_POIS
    assert view.pois[0].id in view.seen
    assert set(view.seen) <= set(wall_prints(room))
    assert 10.0 <= view.angle_deg <= 30.0
    assert 2.0 <= view.distance_m <= 6.0
    x0, y0, x1, y1 = room.interior
    for pose in (view.world_from_monitor, view.world_from_phone):
        assert x0 < pose.translation[0] < x1
        assert y0 < pose.translation[1] < y1
    for poi in view.pois:
        middle = MONITOR_CAMERA.project(view.world_from_monitor.inverse().apply(poi.in_world[None]))[0]
        assert (
            np.linalg.norm(middle - poi.corners_px.mean(axis=0)) < 0.2 * np.ptp(poi.corners_px, axis=0).max()
        )


def test_a_room_without_prints_has_no_view() -> None:
    from app.demonstration.scene import demo_scene

    rng = np.random.default_rng(0)
    cameras = MONITOR_CAMERA, PHONE_CAMERA
    assert sample_view(rng, demo_scene(), room_by_id("0-lift"), cameras, (3.0, 45.0), (2.0, 10.0)) is None
