"""A lens that nobody calibrated: found from pairs of frames with depth, and together with a picture's pose."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry import lens as lens_module
from app.geometry.camera import Camera
from app.geometry.covariance import pose_accuracy, pose_covariance
from app.geometry.lens import LENS_SIGMA, Focal, Lens, SharedPoints, fit_lens, refine_lens
from app.geometry.pose_refinement import refine_pose
from app.geometry.se3 import Pose, perturbed
from tests.synthetic import CAMERAS, random_pixels, random_pose

Array = NDArray[np.float64]
PINHOLE = CAMERAS["PINHOLE"]


def pairs_through(coefficient: float, *, noise_px: float = 0.5, count: int = 12) -> list[SharedPoints]:
    """Return what frames 0.2 m apart share, seen through a lens; depths 1 % and poses a centimetre and 0.6 deg off,
    some matches wrong."""
    rng = np.random.default_rng(5)
    camera = Lens(coefficient).of(PINHOLE)
    pairs = []
    for _ in range(count):
        pixels = random_pixels(rng, camera, 150)
        depth_m = rng.uniform(1.0, 4.0, 150)
        b_from_a = perturbed(Pose.identity(), np.r_[rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.1])
        seen = camera.project(b_from_a.apply(camera.unproject(pixels, depth_m)))
        seen += rng.normal(size=seen.shape) * noise_px
        seen[:10] += 8.0
        told = perturbed(b_from_a, np.full(6, 0.01))
        pairs.append(SharedPoints(pixels, depth_m * rng.normal(1.0, 0.01, 150), seen, told))
    return pairs


@pytest.mark.parametrize("coefficient", [-0.08, -0.03, 0.0, 0.05])
def test_pairs_of_frames_show_the_lens(coefficient: float) -> None:
    found = fit_lens(pairs_through(coefficient), PINHOLE)
    assert found.coefficient == pytest.approx(coefficient, abs=max(4 * found.sigma, 0.002))
    assert found.sigma < 0.002


def test_threads_and_their_parts_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = pairs_through(-0.03)
    alone = fit_lens(pairs, PINHOLE)
    monkeypatch.setattr(lens_module, "OPTIONS", replace(lens_module.OPTIONS, slice_pairs=5))
    with ThreadPoolExecutor(3) as executor:
        assert fit_lens(pairs, PINHOLE, executor.map) == alone


def test_a_lens_needs_something_to_tell_it() -> None:
    assert fit_lens([], PINHOLE) == Lens(0.0, LENS_SIGMA)


def picture_through(coefficient: float, focal: float = 1.0, n: int = 150) -> tuple[Array, Array, Pose]:
    """Return pixels (n, 2) of world points (n, 3) through a lens and a longer focal length, and the true pose."""
    rng = np.random.default_rng(9)
    fx, fy, cx, cy = PINHOLE.params
    camera = Lens(coefficient).of(Camera("PINHOLE", 640, 480, (fx * focal, fy * focal, cx, cy)))
    pose, pixels = random_pose(rng), random_pixels(rng, camera, n)
    points = pose.apply(camera.unproject(pixels, rng.uniform(1.0, 5.0, n)))
    return pixels + rng.normal(size=(n, 2)) * 0.5, points, pose


def test_a_picture_shows_its_lens_and_the_pose_gets_better() -> None:
    pixels, points, pose = picture_through(-0.04)
    by_pinhole = refine_pose(pixels, points, PINHOLE, pose)
    camera = refine_lens(pixels, points, PINHOLE, by_pinhole, Lens(), Focal(PINHOLE.focal_px))
    assert camera.params[4] == pytest.approx(-0.04, abs=0.01)
    assert camera.params[:4] == PINHOLE.params
    found = refine_pose(pixels, points, camera, by_pinhole)
    off_m = [float(np.linalg.norm(each.translation - pose.translation)) for each in (by_pinhole, found)]
    assert off_m[1] < 0.5 * off_m[0]


def test_lens_and_focal_length_are_found_together() -> None:
    pixels, points, pose = picture_through(-0.04, focal=1.04)
    focal = Focal(PINHOLE.focal_px, float("inf"))
    camera = refine_lens(pixels, points, PINHOLE, refine_pose(pixels, points, PINHOLE, pose), Lens(), focal)
    assert camera.focal_px == pytest.approx(1.04 * PINHOLE.focal_px, rel=0.01)
    assert camera.params[4] == pytest.approx(-0.04, abs=0.015)


def test_what_is_known_of_a_lens_holds_against_a_few_matches() -> None:
    pixels, points, pose = picture_through(-0.04, n=12)
    known = Lens(0.02, 0.001)
    camera = refine_lens(pixels, points, PINHOLE, pose, known, Focal(PINHOLE.focal_px))
    assert camera.params[4] == pytest.approx(0.02, abs=0.002)


def test_points_behind_the_camera_show_no_lens() -> None:
    pixels, points, pose = picture_through(0.0)
    behind = pose.apply(pose.inverse().apply(points) * [1, 1, -1])
    with pytest.raises(DegenerateGeometryError):
        refine_lens(pixels, behind, PINHOLE, pose, Lens(), Focal(PINHOLE.focal_px))


def test_a_lens_that_is_not_known_makes_the_pose_less_certain() -> None:
    pixels, points, pose = picture_through(0.0)
    known, guessed = (
        pose_accuracy(pose_covariance(pixels, points, PINHOLE, pose, lens_sigma=sigma))
        for sigma in (0.0, LENS_SIGMA)
    )
    assert known[0] < guessed[0] < 3 * known[0]
    assert known[1] < guessed[1]
