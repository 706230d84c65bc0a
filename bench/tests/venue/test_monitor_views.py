"""Sampled monitoring cameras and phones obey the protocol."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.geometry.camera import Camera
from app.vision.images import decode_image
from bench.recordings.monitor_views import MIN_POIS, sample_view
from bench.recordings.monitors import MONITOR_CAMERA, MonitorPair, render_rolled_phones
from bench.recordings.queries import PHONE_CAMERA
from bench.render import frames
from bench.render.scene import Scene, build_scene
from bench.render.surfaces import Surface
from bench.venue.decor import wall_prints
from bench.venue.layout import room_by_id
from tests.scenes import pose_at

pytest.importorskip("embreex")


def test_camera_and_phone_see_the_same_print_from_the_same_room(outline: Scene) -> None:
    room = room_by_id("0-lobby")
    rng = np.random.default_rng(3)
    view = sample_view(rng, outline, room, (MONITOR_CAMERA, PHONE_CAMERA), (10.0, 30.0), (2.0, 6.0))
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


def test_a_room_without_prints_has_no_view(outline: Scene) -> None:
    rng = np.random.default_rng(0)
    cameras = MONITOR_CAMERA, PHONE_CAMERA
    assert sample_view(rng, outline, room_by_id("0-lift"), cameras, (3.0, 45.0), (2.0, 10.0)) is None


def test_a_phone_that_is_rolled_sees_its_picture_turned(
    tmp_path: Path, surfaces: list[Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    lobby = build_scene([each for each in surfaces if each.room == "0-lobby"])
    monkeypatch.setattr(frames, "scene_of", lambda _: lobby)
    camera = Camera("PINHOLE", 96, 96, (80.0, 80.0, 47.5, 47.5))
    room = room_by_id("0-lobby")
    x0, y0, x1, y1 = room.interior
    pose = pose_at(0.5 * (x0 + x1), 0.5 * (y0 + y1), 1.5, 20.0, 5.0)
    name = "pair_0000"
    pair = MonitorPair(
        name=name,
        floor=0,
        monitor=tmp_path / "monitor.jpg",
        phone=tmp_path / "phone.jpg",
        world_from_monitor=pose,
        world_from_phone=pose,
        pois=(),
        seen=(),
        angle_deg=0.0,
        distance_m=3.0,
    )
    shown = {}
    for roll_deg in (0.0, 90.0):
        folder = tmp_path / f"{roll_deg:.0f}"
        (rolled,) = render_rolled_phones(folder, [pair], roll_deg, phone_camera=camera)
        assert rolled.phone.is_file()
        assert np.allclose(rolled.world_from_phone.rotation[:, 2], pose.rotation[:, 2])
        shown[roll_deg] = decode_image(rolled.phone.read_bytes()).astype(float)
    turned = np.abs(np.rot90(shown[0.0], -1) - shown[90.0]).mean()
    assert turned < 0.3 * np.abs(shown[0.0] - shown[90.0]).mean()
