"""Relative poses of cameras whose verticals are known."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.epipolar import estimate_relative_pose
from app.geometry.estimators.relative_refinement import KnownVerticals
from app.geometry.se3 import Pose, rotation_angle_deg, rotation_from_vector
from app.geometry.upright_relative import estimate_upright_relative_pose
from tests.scenes import CAMERA
from tests.synthetic import CAMERAS, MODELS, make_two_views

SIGMA = float(np.radians(1.8))


def verticals_of(
    b_from_a: Pose, rng: np.random.Generator | None = None, off_deg: float = 0.0
) -> KnownVerticals:
    """Return the verticals of two cameras, the second one's off by about so much."""
    in_a = np.array([0.1, 0.95, 0.3]) / np.linalg.norm([0.1, 0.95, 0.3])
    off = np.zeros(3) if rng is None else rng.normal(size=3)
    turn = rotation_from_vector(np.radians(off_deg) * off / max(float(np.linalg.norm(off)), 1e-9))
    return KnownVerticals(in_a, turn @ b_from_a.rotation @ in_a, SIGMA)


def off_deg(found: Pose, true: Pose) -> float:
    direction = true.translation / np.linalg.norm(true.translation)
    cosine = np.clip(found.translation @ direction, -1.0, 1.0)
    return max(rotation_angle_deg(found.rotation.T @ true.rotation), float(np.degrees(np.arccos(cosine))))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_finds_the_pose_among_wrong_matches(model: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    views = make_two_views(rng, models=(model, "PINHOLE"), n=400, noise_px=0.4, outlier_ratio=0.6)
    found = estimate_upright_relative_pose(
        views.points_a_px, views.points_b_px, views.camera_a, views.camera_b, verticals_of(views.b_from_a),
        max_error_px=2.0,
    )  # fmt: skip
    assert found is not None
    assert off_deg(found.b_from_a, views.b_from_a) < 2.0
    assert found.inlier_mask[views.is_true].mean() > 0.95
    assert found.parallax_deg > 1.0


@pytest.mark.parametrize("seed", range(4))
def test_the_matches_correct_verticals_that_are_a_little_off(seed: int) -> None:
    rng = np.random.default_rng(seed)
    views = make_two_views(rng, n=400, noise_px=0.3, outlier_ratio=0.4)
    known = verticals_of(views.b_from_a, rng, off_deg=2.0)
    found = estimate_upright_relative_pose(
        views.points_a_px, views.points_b_px, views.camera_a, views.camera_b, known, max_error_px=2.0
    )
    assert found is not None
    assert off_deg(found.b_from_a, views.b_from_a) < 1.5


def wall(rng: np.random.Generator, true: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Return noisy matches of a wall with nothing before it."""
    points = np.column_stack([rng.uniform(-1.2, 1.2, 300), rng.uniform(-0.8, 0.8, 300), np.full(300, 4.5)])
    a, b = CAMERA.project(points), CAMERA.project(true.apply(points))
    seen = CAMERA.contains(a) & CAMERA.contains(b)
    return tuple(side[seen] + rng.normal(0, 0.7, side[seen].shape) for side in (a, b))


def test_a_wall_leaves_one_pose_where_the_verticals_are_known() -> None:
    true = Pose(rotation_from_vector([0.05, 0.3, 0.0]), np.array([-1.2, 0.3, 0.1]))
    free, upright = [], []
    for seed in range(8):
        a, b = wall(np.random.default_rng(seed), true)
        one = estimate_relative_pose(a, b, CAMERA, CAMERA, max_error_px=2.0)
        other = estimate_upright_relative_pose(a, b, CAMERA, CAMERA, verticals_of(true), max_error_px=2.0)
        assert one is not None
        assert other is not None
        free.append(off_deg(one.b_from_a, true))
        upright.append(off_deg(other.b_from_a, true))
    assert max(upright) < 10.0 < max(free)


def test_too_little_gives_none_and_bad_numbers_an_error() -> None:
    camera = CAMERAS["PINHOLE"]
    known = KnownVerticals(np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 0.0]), SIGMA)
    few, spot = np.zeros((7, 2)), np.full((30, 2), 7.0)
    assert estimate_upright_relative_pose(few, few, camera, camera, known) is None
    # All matches in one spot agree with any pose, and meet nowhere.
    found = estimate_upright_relative_pose(spot, spot, camera, camera, known)
    assert found is None or found.parallax_deg < 1.0
    with pytest.raises(InvalidInputError):
        estimate_upright_relative_pose(np.full((30, 2), np.nan), spot, camera, camera, known)


def test_verticals_say_nothing_of_turns_about_them() -> None:
    down = np.array([0.6, 0.8, 0.0])
    information = KnownVerticals(down, down, 0.1).information()
    np.testing.assert_allclose(information @ down, np.zeros(3), atol=1e-9)
    assert np.array([0.0, 0.0, 1.0]) @ information @ np.array([0.0, 0.0, 1.0]) == pytest.approx(100.0)
