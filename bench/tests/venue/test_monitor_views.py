"""Sampled monitoring cameras and phones obey the protocol."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.geometry.camera import Camera
from app.vision.images import decode_image
from bench.recordings.monitor_views import MIN_POIS, sample_view
from bench.recordings.monitors import MONITOR_CAMERA, MonitorPair, render_again, render_rolled_phones
from bench.recordings.queries import PHONE_CAMERA
from bench.render import frames
from bench.render.daylight import EVENING
from bench.render.scene import Building, Scene, build_scene
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


def pair_in_lobby(folder: Path) -> MonitorPair:
    x0, y0, x1, y1 = room_by_id("0-lobby").interior
    pose = pose_at(0.5 * (x0 + x1), 0.5 * (y0 + y1), 1.5, 20.0, 5.0)
    return MonitorPair(
        name="pair_0000",
        floor=0,
        monitor=folder / "monitor.jpg",
        phone=folder / "phone.jpg",
        world_from_monitor=pose,
        world_from_phone=pose,
        pois=(),
        seen=(),
        angle_deg=0.0,
        distance_m=3.0,
    )


def test_pairs_are_rendered_again_by_a_larger_phone_and_in_another_light(
    tmp_path: Path, surfaces: list[Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    lobby = [each for each in surfaces if each.room == "0-lobby"]
    monkeypatch.setattr(frames, "scene_of", lambda made: build_scene(lobby, made.daylight))
    pair = pair_in_lobby(tmp_path / "first")
    camera = Camera("PINHOLE", 96, 72, (80.0, 80.0, 47.5, 35.5))
    larger = Camera("PINHOLE", 192, 144, (160.0, 160.0, 95.5, 71.5))
    (plain,) = render_again(tmp_path / "plain", [pair], phone_camera=camera)
    (large,) = render_again(tmp_path / "large", [pair], phone_camera=larger)
    (dark,) = render_again(
        tmp_path / "dark", [pair], phone_camera=camera, building=Building(daylight=EVENING)
    )
    shown = {
        name: decode_image(each.phone.read_bytes()).astype(float)
        for name, each in (("plain", plain), ("large", large), ("dark", dark))
    }
    assert shown["large"].shape == (144, 192, 3)
    halved = shown["large"].reshape(72, 2, 96, 2, 3).mean(axis=(1, 3))
    assert np.abs(halved - shown["plain"]).mean() < 12
    assert shown["dark"].mean() < 0.7 * shown["plain"].mean()
    assert plain.world_from_phone is pair.world_from_phone
    written = plain.phone.stat().st_mtime_ns
    render_again(tmp_path / "plain", [pair], phone_camera=camera)
    assert plain.phone.stat().st_mtime_ns == written


def test_a_phone_that_is_rolled_sees_its_picture_turned(
    tmp_path: Path, surfaces: list[Surface], monkeypatch: pytest.MonkeyPatch
) -> None:
    lobby = build_scene([each for each in surfaces if each.room == "0-lobby"])
    monkeypatch.setattr(frames, "scene_of", lambda _: lobby)
    camera = Camera("PINHOLE", 96, 96, (80.0, 80.0, 47.5, 47.5))
    pair = pair_in_lobby(tmp_path)
    pose = pair.world_from_phone
    shown = {}
    for roll_deg in (0.0, 90.0):
        folder = tmp_path / f"{roll_deg:.0f}"
        (rolled,) = render_rolled_phones(folder, [pair], roll_deg, phone_camera=camera)
        assert rolled.phone.is_file()
        assert np.allclose(rolled.world_from_phone.rotation[:, 2], pose.rotation[:, 2])
        shown[roll_deg] = decode_image(rolled.phone.read_bytes()).astype(float)
    turned = np.abs(np.rot90(shown[0.0], -1) - shown[90.0]).mean()
    assert turned < 0.3 * np.abs(shown[0.0] - shown[90.0]).mean()
