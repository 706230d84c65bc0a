import cv2
import numpy as np
import pytest

from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from bench.recordings.queries import PHONE_CAMERA
from bench.recordings.scan import SCAN_CAMERA
from bench.recordings.trajectory import camera_pose
from bench.render.raycast import render
from bench.render.scene import Scene, build_scene
from bench.render.surfaces import Surface
from bench.venue.layout import room_by_id

FISHEYE = Camera("OPENCV_FISHEYE", 640, 480, (300.0, 300.0, 319.5, 239.5, -0.02, 0.004, 0.0, 0.0))


def pose_at(
    x: float, y: float, z: float, heading_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> Pose:
    return camera_pose(np.array([x, y, z]), *np.radians([heading_deg, pitch_deg, roll_deg]))


def world_points(
    camera: Camera, world_from_camera: Pose, depth_m: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    depths = depth_m[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    return world_from_camera.apply(camera.unproject(pixels, depths))


@pytest.mark.parametrize("camera", [SCAN_CAMERA, PHONE_CAMERA, FISHEYE], ids=lambda camera: camera.model)
def test_depth_is_that_of_the_wall_in_front(gallery: Scene, camera: Camera):
    x_wall = room_by_id("0-gallery-a").interior[0]
    pose = pose_at(2.6, 12.0, 1.5, 176.0, 3.0, 5.0)
    _, depth_m = render(gallery, camera, pose)
    grid = (
        np.stack(np.meshgrid(np.arange(200, 440, 7), np.arange(150, 330, 7)), -1).reshape(-1, 2).astype(float)
    )
    points = world_points(camera, pose, depth_m, grid)
    # Pictures hang up to 3 cm before the wall; nothing is behind it.
    off = points[:, 0] - x_wall
    assert off.min() > -1e-4
    assert np.mean(off < 1e-4) > 0.3
    assert off.max() < 0.05


def test_two_views_agree_on_the_place_of_a_point(gallery: Scene):
    a, b = pose_at(6.5, 10.5, 1.5, 150.0, -6.0), pose_at(5.0, 9.6, 1.3, 128.0, 2.0, 4.0)
    depth_a, depth_b = (render(gallery, SCAN_CAMERA, pose)[1] for pose in (a, b))
    rng = np.random.default_rng(5)
    pixels = np.column_stack([rng.integers(0, 640, 4000), rng.integers(0, 480, 4000)]).astype(float)
    points = world_points(SCAN_CAMERA, a, depth_a, pixels)
    in_b = SCAN_CAMERA.project(b.inverse().apply(points))
    seen = SCAN_CAMERA.contains(in_b) & (in_b > 1).all(axis=1) & (in_b < [638, 478]).all(axis=1)
    u, v = in_b[seen].T
    # On a plane inverse depth is linear in the pixel, so interpolating it is exact.
    inverse = cv2.remap(
        1 / depth_b, u[None].astype(np.float32), v[None].astype(np.float32), cv2.INTER_LINEAR
    )[0]
    again = b.apply(SCAN_CAMERA.unproject(in_b[seen], 1 / inverse))
    error_m = np.linalg.norm(again - points[seen], axis=1)
    assert seen.sum() > 1000
    # The rest is hidden in one of the views, or lies at an edge.
    assert np.mean(error_m < 0.002) > 0.85


def test_texture_sticks_to_the_surfaces(gallery: Scene):
    a, b = pose_at(7.0, 12.5, 1.5, 175.0), pose_at(6.2, 13.2, 1.4, 186.0, -3.0)
    (rgb_a, depth_a), (rgb_b, _) = (render(gallery, SCAN_CAMERA, pose) for pose in (a, b))
    sift = cv2.SIFT_create(2000)
    keys_a, words_a = sift.detectAndCompute(cv2.cvtColor(rgb_a, cv2.COLOR_RGB2GRAY), None)
    keys_b, words_b = sift.detectAndCompute(cv2.cvtColor(rgb_b, cv2.COLOR_RGB2GRAY), None)
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(words_a, words_b, k=2) if m.distance < 0.75 * n.distance]
    pixels_a = np.array([keys_a[m.queryIdx].pt for m in pairs])
    pixels_b = np.array([keys_b[m.trainIdx].pt for m in pairs])
    points = world_points(SCAN_CAMERA, a, depth_a, np.round(pixels_a))
    error_px = np.linalg.norm(SCAN_CAMERA.project(b.inverse().apply(points)) - pixels_b, axis=1)
    right = error_px < 4
    assert right.sum() > 200
    assert right.mean() > 0.7
    assert np.median(error_px[right]) < 1.0


def test_building_and_rendering_are_deterministic(surfaces: list[Surface]):
    part = [s for s in surfaces if s.room == "0-lift"]
    one, other = build_scene(part), build_scene(part)
    assert np.array_equal(one.atlas, other.atlas)
    assert np.array_equal(one.light, other.light)
    pose = pose_at(26.5, 17.9, 1.5, 100.0)
    first, second = render(one, SCAN_CAMERA, pose), render(other, SCAN_CAMERA, pose)
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_nothing_hit_has_no_depth_and_is_black(corridors: Scene):
    rgb, depth_m = render(corridors, SCAN_CAMERA, pose_at(100.0, 100.0, 1.5, 0.0))
    assert not depth_m.any()
    assert not rgb.any()


def test_saved_scene_renders_the_same(gallery: Scene, tmp_path):
    gallery.save(tmp_path)
    pose = pose_at(5.0, 12.0, 1.5, 250.0, -10.0)
    saved, kept = render(Scene.load(tmp_path), SCAN_CAMERA, pose), render(gallery, SCAN_CAMERA, pose)
    assert np.array_equal(saved[0], kept[0])
    assert np.array_equal(saved[1], kept[1])


def test_corridors_look_alike_but_not_identical(corridors: Scene):
    views = [
        render(corridors, SCAN_CAMERA, pose_at(26.5, y, z, 4.0))[0].astype(int)
        for y, z in ((6.2, 1.5), (20.0, 1.5), (6.2, 5.0), (20.0, 5.0))
    ]
    for other in views[1:]:
        difference = np.abs(views[0] - other).mean(axis=2)
        assert np.mean(difference < 6) > 0.9
        assert difference.max() > 30
