"""Bundle adjustment: it finds back what noise-free pixels were made of, and keeps what it must."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.geometry.bundle import Bundle, adjust_bundle, lens_in_bundle
from app.geometry.camera import Camera
from app.geometry.lens import Lens
from app.geometry.reprojection import project_from_world
from app.geometry.se3 import Pose, attitude_difference_rad, perturbed, position_difference_m

CAMERAS = [
    Camera("PINHOLE", 640, 480, (525.0, 525.0, 319.5, 239.5)),
    Camera("OPENCV", 640, 480, (525.0, 520.0, 319.5, 239.5, 0.1, -0.1, 0.001, 0.001)),
]
VIEWS, POINTS = 6, 60


def scene(camera: Camera, seed: int) -> tuple[list[Pose], np.ndarray, Bundle]:
    """Return poses along a line, points before them, and the bundle of their noise-free pixels."""
    rng = np.random.default_rng(seed)
    poses = [
        perturbed(Pose.identity(), [*rng.normal(0, 0.02, 3), 0.15 * i, 0.02 * i, 0.0]) for i in range(VIEWS)
    ]
    points = rng.uniform([-1.0, -0.8, 2.5], [1.5, 0.8, 5.0], (POINTS, 3))
    pixels = np.stack([project_from_world(points, camera, pose) for pose in poses])
    inside = np.stack([camera.contains(p) for p in pixels])
    # Each point is missing from some views.
    seen = inside & (rng.uniform(size=inside.shape) < 0.8)
    seen[:2] = inside[:2]
    views, rows = np.nonzero(seen)
    fixed = np.arange(VIEWS) < 2
    none = np.full(POINTS, np.inf)
    bundle = Bundle(
        camera=camera,
        views=views,
        rows=rows,
        pixels=pixels[views, rows],
        is_fixed=fixed,
        prior=points,
        prior_sigma_m=none,
    )
    return poses, points, bundle


def disturbed(poses: list[Pose], points: np.ndarray, seed: int) -> tuple[list[Pose], np.ndarray]:
    rng = np.random.default_rng(seed)
    moved = [
        pose if i < 2 else perturbed(pose, np.concatenate([rng.normal(0, 0.01, 3), rng.normal(0, 0.03, 3)]))
        for i, pose in enumerate(poses)
    ]
    return moved, points + rng.normal(0, 0.05, points.shape)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
@pytest.mark.parametrize("seed", range(3))
def test_poses_and_points_are_found_back(camera: Camera, seed: int) -> None:
    poses, points, bundle = scene(camera, seed)
    found, placed = adjust_bundle(bundle, *disturbed(poses, points, seed + 10), max_steps=30)
    assert all(a is b for a, b in zip(found[:2], poses[:2], strict=True))
    for a, b in zip(found, poses, strict=True):
        assert position_difference_m(a, b) < 1e-3
        assert attitude_difference_rad(a, b) < 1e-3
    assert np.median(np.linalg.norm(placed - points, axis=1)) < 2e-3


def test_wrong_pixels_hardly_move_the_poses() -> None:
    poses, points, bundle = scene(CAMERAS[0], 1)
    rng = np.random.default_rng(2)
    pixels = bundle.pixels.copy()
    wrong = rng.uniform(size=len(pixels)) < 0.05
    pixels[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
    spoilt = replace(bundle, pixels=pixels)
    found, _ = adjust_bundle(spoilt, *disturbed(poses, points, 11), max_steps=30)
    assert max(position_difference_m(a, b) for a, b in zip(found, poses, strict=True)) < 0.01


def test_points_that_are_known_hold_the_scale_without_fixed_views() -> None:
    poses, points, bundle = scene(CAMERAS[0], 3)
    known = np.where(np.arange(POINTS) < 20, 0.001, np.inf)
    free = replace(bundle, is_fixed=np.zeros(VIEWS, dtype=bool), prior_sigma_m=known)
    start, away = disturbed(poses, points, 12)
    away[:20] = points[:20]
    found, _ = adjust_bundle(free, start, away, max_steps=40)
    assert max(position_difference_m(a, b) for a, b in zip(found, poses, strict=True)) < 5e-3


@pytest.mark.parametrize("coefficient", [-0.05, 0.03])
def test_a_bundle_shows_the_lens_behind_which_its_camera_is(coefficient: float) -> None:
    poses, points, bundle = scene(Lens(coefficient).of(CAMERAS[0]), 4)
    lens, sigmas = Lens(), []
    state = disturbed(poses, points, 13)
    for _ in range(6):
        behind = replace(bundle, camera=lens.of(CAMERAS[0]))
        state = adjust_bundle(behind, *state, max_steps=30)
        step, information = lens_in_bundle(behind, *state)
        sigmas.append(information**-0.5)
        lens = Lens(lens.coefficient + step)
    assert lens.coefficient == pytest.approx(coefficient, abs=2e-3)
    assert sigmas[-1] < 0.04


def test_views_through_another_lens_say_nothing_of_it() -> None:
    poses, points, bundle = scene(CAMERAS[0], 3)
    _, information = lens_in_bundle(bundle, poses, points)
    none = replace(bundle, has_lens=np.zeros(VIEWS, dtype=bool))
    assert lens_in_bundle(none, poses, points)[1] == pytest.approx(0.0, abs=1e-6)
    some = replace(bundle, has_lens=np.arange(VIEWS) < 4)
    assert lens_in_bundle(some, poses, points)[1] > 0.1 * information
    every = replace(bundle, has_lens=np.ones(VIEWS, dtype=bool))
    assert lens_in_bundle(every, poses, points)[1] == pytest.approx(information)


def test_a_bundle_of_one_view_shows_no_lens() -> None:
    poses, points, bundle = scene(CAMERAS[0], 5)
    first = bundle.views == 0
    alone = replace(
        bundle,
        views=bundle.views[first],
        rows=bundle.rows[first],
        pixels=bundle.pixels[first],
        is_fixed=np.zeros(1, dtype=bool),
    )
    _, information = lens_in_bundle(alone, poses[:1], points)
    assert information < 0.1
