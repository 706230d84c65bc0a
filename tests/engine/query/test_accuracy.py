"""How accurate a pose is by what it rests on."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.maps.artifact import MapMetadata
from app.engine.query.accuracy import accuracy_in_map, accuracy_of, sigma_across
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy
from app.geometry.se3 import Pose
from tests.maps import map_of
from tests.scenes import CAMERA

CENTRE = np.array([1.0, 2.0, -0.5])
POINT = CENTRE[None] + [0.0, 0.0, 2.0]


def around(degrees: float, distance_m: float = 2.0) -> np.ndarray:
    """Return a place at a distance from the point, so many degrees around it."""
    angle = np.radians(degrees)
    return POINT[0] + distance_m * np.array([np.sin(angle), 0.0, -np.cos(angle)])


def test_noise_along_a_keyframes_ray_counts_as_far_as_the_camera_sees_it_from_beside() -> None:
    points = np.repeat(POINT, 4, axis=0)
    sigma_m = np.array([0.1, 0.1, 0.1, 0.3])
    centres = np.stack([around(0), around(30, 5.0), around(90), around(-90, 1.0)])
    assert sigma_across(sigma_m, points, centres, CENTRE) == pytest.approx([0.0, 0.05, 0.1, 0.3])
    # A point in the keyframe's own centre has no ray.
    assert sigma_across(np.array([0.1]), POINT, POINT[0], CENTRE) == pytest.approx([0.0])


def spread(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels and points of a camera in the origin."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (count, 2))
    return pixels, CAMERA.unproject(pixels, rng.uniform(1.5, 4.0, count))


def test_accuracy_is_of_what_the_points_show() -> None:
    pixels, points = spread()
    exact, noisy = np.zeros(len(points)), np.full(len(points), 0.05)
    by_exact = accuracy_of(pixels, points, exact, CAMERA, Pose.identity())
    by_noisy = accuracy_of(pixels, points, noisy, CAMERA, Pose.identity())
    assert 0 < by_exact.position_m < by_noisy.position_m < 0.2
    assert 0 < by_exact.orientation_deg < by_noisy.orientation_deg < 2.0
    # What is not known of the focal length or the lens makes the place less certain.
    for extra in ((0.05, 0.0), (0.0, 0.03)):
        vague = accuracy_of(pixels, points, exact, CAMERA, Pose.identity(), *extra)
        assert vague.position_m > by_exact.position_m


def test_points_that_leave_the_pose_open_give_no_accuracy() -> None:
    pixels, points = spread()
    same_px, same = np.repeat(pixels[:1], 40, axis=0), np.repeat(points[:1], 40, axis=0)
    found = accuracy_of(same_px, same, np.zeros(40), CAMERA, Pose.identity())
    assert found == Accuracy(float("inf"), 180.0)


def test_in_a_map_only_the_noise_across_the_cameras_rays_counts() -> None:
    pixels, points = spread()
    # One keyframe is where the camera is, the other beside it.
    beside = Pose(np.eye(3), np.array([2.0, 0.0, 0.0]))
    artifact = map_of([Pose.identity(), beside], [points[:1], points[:1]], [np.zeros((1, 128), np.uint8)] * 2)

    def accuracy(keyframe: int, *sigmas: float) -> Accuracy:
        matches = Matches(
            points_px=pixels,
            points_in_world=points,
            sigma_m=np.full(len(points), 0.05),
            query_rows=np.arange(len(points)),
            keyframes=np.full(len(points), keyframe),
            distances=np.zeros(len(points), np.float32),
            distinct=np.ones(len(points), bool),
        )
        return accuracy_in_map(artifact, matches, CAMERA, Pose.identity(), *sigmas)

    exact = accuracy_of(pixels, points, np.zeros(len(points)), CAMERA, Pose.identity())
    assert accuracy(0) == exact
    assert accuracy(1).position_m > 1.5 * exact.position_m
    for sigmas in ((0.05, 0.0), (0.0, 0.03)):
        assert accuracy(0, *sigmas).position_m > exact.position_m


def test_the_maps_own_error_is_added_to_that_of_its_points() -> None:
    metadata = MapMetadata(
        features="sift",
        descriptor_sha256="",
        descriptor_size=8,
        cameras=(CAMERA,),
        keyframe_names=(),
        position_sigma_m=0.03,
        orientation_sigma_deg=1.2,
    )
    found = Accuracy(0.04, 0.5).with_map_error(metadata)
    assert (found.position_m, found.orientation_deg) == pytest.approx((0.05, 1.3))
