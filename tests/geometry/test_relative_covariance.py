"""The covariance of a relative pose against the scatter of poses fitted to noisy matches."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import DegenerateGeometryError
from app.geometry.epipolar import estimate_relative_pose
from app.geometry.relative_covariance import perturbed_relative, relative_pose_covariance
from app.geometry.se3 import Pose, rotation_angle_deg, rotation_from_vector
from tests.scenes import CAMERA

B_FROM_A = Pose(rotation_from_vector([0.05, -0.2, 0.02]), np.array([0.8, 0.1, 0.59]) / 0.999)


def test_it_tells_the_scatter_of_estimates() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-1.2, 1.2, 150), rng.uniform(-1, 1, 150), rng.uniform(2.5, 6, 150)])
    a, b = CAMERA.project(points), CAMERA.project(B_FROM_A.apply(points))
    turns, sigmas = [], []
    for _ in range(30):
        noisy = a + rng.normal(0, 0.4, a.shape), b + rng.normal(0, 0.4, b.shape)
        found = estimate_relative_pose(*noisy, CAMERA, CAMERA)
        assert found is not None
        turns.append(rotation_angle_deg(found.b_from_a.rotation @ B_FROM_A.rotation.T))
        rays = CAMERA.normalize(noisy[0]), CAMERA.normalize(noisy[1])
        covariance = relative_pose_covariance(*rays, found.b_from_a, 1e-6)
        sigmas.append(np.degrees(np.sqrt(np.trace(covariance[:3, :3]))))
    scatter = float(np.sqrt(np.mean(np.square(turns))))
    assert 0.6 * scatter < np.median(sigmas) < 1.7 * scatter


def test_a_change_keeps_the_translations_length() -> None:
    moved = perturbed_relative(B_FROM_A, np.array([0.01, 0, 0, 0.02, -0.03]))
    assert np.linalg.norm(moved.translation) == pytest.approx(np.linalg.norm(B_FROM_A.translation))
    assert rotation_angle_deg(moved.rotation @ B_FROM_A.rotation.T) == pytest.approx(np.degrees(0.01))


def test_too_few_matches_are_refused() -> None:
    with pytest.raises(DegenerateGeometryError):
        relative_pose_covariance(np.zeros((5, 2)), np.zeros((5, 2)), B_FROM_A, 1e-3)


def test_what_is_known_of_the_rotation_narrows_it() -> None:
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-1.2, 1.2, 80), rng.uniform(-1, 1, 80), rng.uniform(3.9, 4.1, 80)])
    rays = CAMERA.normalize(CAMERA.project(points)), CAMERA.normalize(CAMERA.project(B_FROM_A.apply(points)))
    open_, known = (
        relative_pose_covariance(*rays, B_FROM_A, 1e-3, more) for more in (None, np.diag([1e6, 1e6, 0.0]))
    )
    assert known[0, 0] < 1.01e-6 < open_[0, 0]
    assert (np.diag(known) <= np.diag(open_) * (1 + 1e-9)).all()
