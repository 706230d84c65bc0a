"""When a picture's matches say something about focal length and lens, and when they leave it open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.maps.artifact import MapMetadata
from app.engine.query.camera import OPTIONS, fit_query_camera, lens_of_query, scanned_camera
from app.engine.query.matches import Matches
from app.geometry.camera import Camera
from app.geometry.focal import ApproximateCamera, pinhole
from app.geometry.lens import Lens
from app.geometry.pnp import PnpEstimate
from app.geometry.pose_refinement import refine_pose
from app.geometry.se3 import Pose

WIDTH = 640
HEIGHT = 480
FOCAL_PX = 525.0
MIN_FEATURES = OPTIONS.min_features
PINHOLE = pinhole(WIDTH, HEIGHT, FOCAL_PX)
BENT = Lens(-0.1).of(PINHOLE)


def seen(count: int, camera: Camera, is_flat: bool = False, noise_px: float = 0.3) -> Matches:
    """Return matches of a camera in the origin with points 2 to 5 m ahead, or on a wall that it faces squarely."""
    rng = np.random.default_rng(count)
    depth_m = np.full(count, 3.0) if is_flat else rng.uniform(2.0, 5.0, count)
    points = PINHOLE.unproject(rng.uniform([30, 30], [WIDTH - 30, HEIGHT - 30], (count, 2)), depth_m)
    pixels = camera.project(points) + rng.normal(0, noise_px, (count, 2))
    return Matches(
        points_px=pixels,
        points_in_world=points,
        sigma_m=np.full(count, 0.01),
        query_rows=np.arange(count),
        keyframes=np.zeros(count, np.intp),
        distances=np.zeros(count, np.float32),
        distinct=np.ones(count, bool),
    )


def fitted(
    matches: Matches,
    camera: Camera,
    known: Camera | ApproximateCamera | None,
    lens: Lens | None = None,
    ahead: bool = True,
) -> Camera | None:
    """Return the camera fitted to matches, from the pose that they have with the given one."""
    pose = Pose.identity() if ahead else Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    if ahead:
        pose = refine_pose(matches.points_px, matches.points_in_world, camera, pose)
    estimate = PnpEstimate(pose, np.ones(len(matches), bool), 0.0, 1)
    return fit_query_camera(matches, estimate, camera, known, lens)


def test_a_room_shows_the_focal_length() -> None:
    found = fitted(seen(300, PINHOLE), pinhole(WIDTH, HEIGHT, 1.04 * FOCAL_PX), None)
    assert found is not None
    assert found.focal_px == pytest.approx(FOCAL_PX, rel=0.01)


@pytest.mark.parametrize("lens", [None, Lens()], ids=["lens stated", "lens not known"])
def test_a_wall_seen_squarely_shows_none(lens: Lens | None) -> None:
    # Nearer with a wider lens is the same picture, so that no focal length is the best one.
    for focal_px in (0.7 * FOCAL_PX, FOCAL_PX, 1.3 * FOCAL_PX):
        assert fitted(seen(300, PINHOLE, is_flat=True), pinhole(WIDTH, HEIGHT, focal_px), None, lens) is None


def test_enough_features_show_the_lens_and_fewer_could_be_a_wrong_pose() -> None:
    lens = fitted(seen(300, BENT), PINHOLE, PINHOLE, Lens())
    assert lens is not None
    assert lens.params[4] == pytest.approx(-0.1, abs=0.03)
    assert fitted(seen(45, BENT), PINHOLE, PINHOLE, Lens()) != PINHOLE
    assert fitted(seen(20, BENT), PINHOLE, PINHOLE, Lens()) == PINHOLE
    # Just at the limit.
    assert fitted(seen(MIN_FEATURES, BENT), PINHOLE, PINHOLE, Lens()) != PINHOLE
    assert fitted(seen(MIN_FEATURES - 1, BENT), PINHOLE, PINHOLE, Lens()) == PINHOLE


def test_features_count_once_however_many_keyframes_they_were_matched_in() -> None:
    few = seen(MIN_FEATURES - 1, BENT)
    assert fitted(Matches.merge([few, few]), PINHOLE, PINHOLE, Lens()) == PINHOLE


def test_a_lens_that_is_stated_is_left_alone() -> None:
    assert fitted(seen(300, BENT), PINHOLE, PINHOLE, None) == PINHOLE


def test_where_no_lens_fits_a_given_camera_is_kept() -> None:
    # All points behind the camera: nothing to fit.
    assert fitted(seen(300, PINHOLE), PINHOLE, PINHOLE, Lens(), ahead=False) == PINHOLE


def test_an_approximate_camera_keeps_the_focal_length_near_what_was_known() -> None:
    near = ApproximateCamera(pinhole(WIDTH, HEIGHT, 0.95 * FOCAL_PX))
    found = fitted(seen(300, PINHOLE), pinhole(WIDTH, HEIGHT, 1.03 * FOCAL_PX), near, Lens())
    assert found is not None
    assert found.focal_px == pytest.approx(FOCAL_PX, rel=0.01)
    # A squarely seen wall leaves the known one, and one far from it is not near.
    wall = seen(300, PINHOLE, is_flat=True)
    kept = fitted(wall, PINHOLE, near, Lens())
    assert kept is not None
    assert kept.focal_px == pytest.approx(near.camera.focal_px, rel=0.01)
    assert fitted(wall, pinhole(WIDTH, HEIGHT, 1.5 * FOCAL_PX), near, Lens()) is None


def test_where_a_picture_says_little_the_known_focal_length_has_its_full_weight() -> None:
    # A wall with a relief of 6 %: by the picture the focal length is known about as well as before.
    rng = np.random.default_rng(1)
    flat = seen(60, PINHOLE)
    depth_m = 3.0 * (1 + rng.uniform(-0.06, 0.06, 60))
    points = PINHOLE.unproject(rng.uniform([30, 30], [WIDTH - 30, HEIGHT - 30], (60, 2)), depth_m)
    relief = replace(flat, points_in_world=points, points_px=PINHOLE.project(points))
    near = ApproximateCamera(pinhole(WIDTH, HEIGHT, 0.93 * FOCAL_PX))
    found = fitted(relief, PINHOLE, near, Lens())
    assert found is not None
    assert found.focal_px == pytest.approx(0.966 * FOCAL_PX, rel=0.005)


def scanned_with(*lens_sigmas: float) -> MapMetadata:
    """Return the metadata of a map whose scan's camera is bent, its lens known to within a sigma."""
    return MapMetadata(
        features="sift",
        descriptor_sha256="",
        descriptor_size=8,
        cameras=(BENT,),
        keyframe_names=(),
        lens_sigmas=lens_sigmas,
    )


def test_the_lens_of_a_query_is_that_of_the_scan_when_it_is_the_scans_camera() -> None:
    shown = scanned_with(0.004)
    assert lens_of_query(shown, PINHOLE) == Lens(-0.1, 0.004)
    # Another focal length is another camera, of which nothing is known.
    assert lens_of_query(shown, pinhole(WIDTH, HEIGHT, 500.0)) == Lens()
    assert lens_of_query(scanned_with(), PINHOLE) == Lens()
    # Nor is it of one that was not given, or only by a photo's tags; one with its distortion stated has none to find.
    assert lens_of_query(shown, None) == lens_of_query(shown, ApproximateCamera(PINHOLE)) == Lens()
    assert lens_of_query(shown, BENT) is None


def test_a_scans_camera_has_the_lens_that_the_scan_showed() -> None:
    found = scanned_camera(scanned_with(0.004), PINHOLE)
    assert (found.model, found.width, found.height) == ("OPENCV", WIDTH, HEIGHT)
    assert found.params == (*PINHOLE.params, -0.1, 0.0, 0.0, 0.0)
    # A guess is not stated, and what is stated stays.
    assert scanned_camera(scanned_with(0.02), PINHOLE) == PINHOLE
    assert scanned_camera(scanned_with(), PINHOLE) == PINHOLE
    assert scanned_camera(scanned_with(0.004), BENT) == BENT
