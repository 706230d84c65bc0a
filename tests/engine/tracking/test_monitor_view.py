"""A monitoring camera's view of tracked points: its pixels as the phone's, what later looks add, and the scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.poi_triangulation import scale_by_pois
from app.engine.tracking.odometry.monitor_view import MonitorView, SeenByMonitor
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.lens import Lens
from app.geometry.se3 import Pose

PHONE = Camera("PINHOLE", 640, 480, (500.0, 500.0, 320.0, 240.0))
MONITOR = Camera("PINHOLE", 1280, 720, (900.0, 900.0, 640.0, 360.0))


def seen_by(camera: Camera, pixels: np.ndarray) -> SeenByMonitor:
    return SeenByMonitor(camera, Pose(np.eye(3), np.array([1.0, 2.0, 3.0])), pixels)


def test_pixels_of_another_camera_are_those_of_the_same_rays() -> None:
    pixels = np.array([[100.0, 200.0], [900.0, 500.0]])
    view = MonitorView.of(seen_by(MONITOR, pixels), np.array([7, 3]), np.array([0, 1]))
    assert view.ids.tolist() == [3, 7]
    behind = Lens(-0.05).of(PHONE)
    assert not view.has_lens_of(behind)
    assert behind.normalize(view.pixels_in(behind)) == pytest.approx(
        MONITOR.normalize(pixels[::-1]), abs=1e-6
    )


def test_a_camera_of_the_same_make_has_the_same_lens() -> None:
    pixels = np.array([[100.0, 200.0], [500.0, 300.0]])
    own = PHONE.scaled_to(320, 240)
    view = MonitorView.of(seen_by(PHONE, pixels), np.array([1, 2]), np.array([0, 1]))
    for camera in (own, Lens(-0.1).of(own)):
        assert view.has_lens_of(camera)
        assert view.pixels_in(camera) == pytest.approx((pixels + 0.5) / 2 - 0.5)
    stated = MonitorView.of(seen_by(Lens(-0.1).of(PHONE), pixels), np.array([1, 2]), np.array([0, 1]))
    assert not stated.has_lens_of(own)


def test_a_later_look_adds_what_was_not_seen() -> None:
    first = MonitorView.of(
        seen_by(PHONE, np.array([[10.0, 10], [20, 20]])), np.array([1, 5]), np.array([0, 1])
    )
    later = MonitorView.of(
        seen_by(PHONE, np.array([[11.0, 11], [30, 30]])), np.array([5, 3]), np.array([0, 1])
    )
    both = first.with_more(later)
    assert both.ids.tolist() == [1, 3, 5]
    assert both.seen.points_px.tolist() == [[10, 10], [30, 30], [20, 20]]


def test_the_scale_is_what_known_distances_say_of_the_points_that_are_there() -> None:
    rng = np.random.default_rng(4)
    pixels = rng.uniform(280, 360, (40, 2))
    region = ((280.0, 280.0), (360.0, 280.0), (360.0, 360.0), (280.0, 360.0))
    spec = AnchorSpec(
        venue_id="door",
        floor_id="0",
        x=0.0,
        y=0.0,
        height_m=2.5,
        heading_deg=None,
        camera=hint_of(PHONE),
        pois=(Poi(id="p", region_px=region, x=3.0, y=0.0, distance_m=3.0),),
    )
    seen = replace(seen_by(PHONE, pixels), scale_of=lambda px, away: scale_by_pois(spec, PHONE, px, away))
    ids = np.arange(40)
    view = MonitorView.of(seen, ids, ids)
    rays = PHONE.unproject(pixels, np.ones(40))
    points = seen.frame_from_camera.translation + 2.5 * rays / np.linalg.norm(rays, axis=1)[:, None]
    found = view.scale(ids[5:], points[5:])
    assert found is not None
    assert found[0] == pytest.approx(np.log(3.0 / 2.5))
    assert 0.02 < found[1] < 0.12
    # Too few in the region, or nothing that is known, say nothing.
    assert view.scale(ids[:2], points[:2]) is None
    assert MonitorView.of(seen_by(PHONE, pixels), ids, ids).scale(ids, points) is None
