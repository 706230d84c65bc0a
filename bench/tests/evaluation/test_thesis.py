"""The thesis's pipeline on points whose place is known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.features import NO_WORDS, AnchorFeatures
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from bench.baselines.thesis_anchor import NO_XFEAT, MonitorView, locate_by_thesis
from bench.baselines.thesis_odometry import ThesisOdometry
from tests.scenes import pose_at

PHONE = Camera("PINHOLE", 640, 480, (520.0, 520.0, 320.0, 240.0))
MONITOR = Camera("PINHOLE", 1280, 720, (900.0, 900.0, 640.0, 360.0))
MONITOR_POSE = pose_at(0.5, 0.5, 2.5, yaw_deg=35.0, pitch_deg=-15.0)
POI_M = np.array([5.0, 4.0, 1.5])


def scene(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return world points (n, 3), the POI first, and a descriptor (n, 61) of each."""
    rng = np.random.default_rng(seed)
    around = POI_M + rng.uniform([-1.5, -1.5, -1.0], [2.5, 2.5, 1.0], (150, 3))
    points = np.vstack([POI_M, around])
    return points, rng.integers(0, 256, (len(points), 61)).astype(np.uint8)


def features(points: np.ndarray, descriptors: np.ndarray, camera: Camera, pose: Pose) -> AnchorFeatures:
    """Return what a camera sees of the points."""
    in_camera = pose.inverse().apply(points)
    pixels = camera.project(in_camera)
    seen = (in_camera[:, 2] > 0) & ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    return AnchorFeatures(
        akaze=LocalFeatures(pixels[seen].astype(np.float32), descriptors[seen]),
        xfeat=NO_XFEAT,
        words=NO_WORDS,
    )


def monitor_view(points: np.ndarray, descriptors: np.ndarray) -> MonitorView:
    middle = MONITOR.project(MONITOR_POSE.inverse().apply(POI_M[None]))[0]
    region = [middle + np.array(corner) for corner in ((-25, -25), (25, -25), (25, 25), (-25, 25))]
    x, y, z = MONITOR_POSE.translation
    poi = Poi(
        id="exit",
        region_px=tuple((float(u), float(v)) for u, v in region),
        x=POI_M[0],
        y=POI_M[1],
        distance_m=float(np.linalg.norm(POI_M - MONITOR_POSE.translation)),
    )
    spec = AnchorSpec(
        venue_id="v",
        floor_id="0",
        x=x,
        y=y,
        height_m=z,
        heading_deg=None,
        camera=hint_of(MONITOR),
        pois=(poi,),
    )
    return MonitorView(spec, MONITOR, features(points, descriptors, MONITOR, MONITOR_POSE))


def down_in(pose: Pose) -> np.ndarray:
    return np.asarray(pose.rotation.T @ np.array([0.0, 0.0, -1.0]))


@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(20.0, 0.0), (55.0, 8.0), (75.0, -10.0)])
def test_the_equations_place_a_phone_on_the_plan(yaw_deg: float, pitch_deg: float) -> None:
    points, descriptors = scene()
    # The phone looks at the POI from either side of the line of sight: the angle's sign matters.
    place = POI_M - 4.0 * np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg)), 0.0])
    phone = pose_at(place[0], place[1], 1.5, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    seen = features(points, descriptors, PHONE, phone)
    fix = locate_by_thesis(monitor_view(points, descriptors), seen, PHONE, down_in(phone))
    assert fix is not None
    assert fix.on_plan == pytest.approx(phone.translation[:2], abs=0.02)
    assert fix.poi == "exit"


def test_without_gravity_a_tilted_phone_is_misplaced() -> None:
    points, descriptors = scene()
    phone = pose_at(1.5, 3.0, 1.5, yaw_deg=15.0, pitch_deg=14.0)
    seen = features(points, descriptors, PHONE, phone)
    monitor = monitor_view(points, descriptors)
    known = locate_by_thesis(monitor, seen, PHONE, down_in(phone))
    assumed = locate_by_thesis(monitor, seen, PHONE, None)
    assert known is not None
    assert assumed is not None
    assert known.on_plan == pytest.approx(phone.translation[:2], abs=0.02)
    assert np.linalg.norm(assumed.on_plan - phone.translation[:2]) > 0.05


def test_there_is_no_place_without_the_poi() -> None:
    points, descriptors = scene()
    phone = pose_at(1.5, 3.0, 1.5, yaw_deg=15.0)
    pixels = MONITOR.project(MONITOR_POSE.inverse().apply(points))
    elsewhere = np.abs(pixels - pixels[0]).max(axis=1) > 26
    seen = features(points[elsewhere], descriptors[elsewhere], PHONE, phone)
    assert locate_by_thesis(monitor_view(points, descriptors), seen, PHONE, down_in(phone)) is None


def test_odometry_goes_on_in_metres_from_the_start() -> None:
    points, descriptors = scene()
    first = pose_at(1.5, 3.0, 1.5, yaw_deg=15.0)
    start = features(points, descriptors, PHONE, first)
    fix = locate_by_thesis(monitor_view(points, descriptors), start, PHONE, down_in(first))
    assert fix is not None
    odometry = ThesisOdometry(fix, start, PHONE)
    for step in range(1, 6):
        moved = pose_at(1.5 + 0.2 * step, 3.0 - 0.1 * step, 1.5, yaw_deg=15.0 + step)
        found = odometry.track(features(points, descriptors, PHONE, moved))
        assert found is not None
        assert found[0] == pytest.approx(moved.translation[:2], abs=0.03)
    assert odometry.track(features(points[:0], descriptors[:0], PHONE, first)) is None
