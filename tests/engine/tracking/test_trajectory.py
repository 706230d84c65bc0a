"""The path between two fixes, corrected by them: nearer to the truth, smooth, and as sure of each end as its fix is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from app.engine.query.placed import Accuracy
from app.engine.tracking.trajectory import Anchored, corrected_path, largest_change_m
from app.geometry.graphs.pose_graph import relative_error
from app.geometry.se3 import (
    Pose,
    attitude_difference_rad,
    perturbed,
    position_difference_m,
    rotation_from_vector,
)
from tests.scenes import pose_at

SURE = Accuracy(0.01, 0.1)
# Once around a room, facing along the way.
TRUTH = [
    pose_at(2.0 * np.cos(a), 2.0 * np.sin(a), 1.5, float(np.degrees(a)) + 90.0)
    for a in np.linspace(0.0, 1.5 * np.pi, 60)
]


def drifted(scale: float, turn_rad: float, truth: list[Pose] = TRUTH) -> list[Pose]:
    """Return a path whose steps are too long by a factor and turn too far."""
    path = [truth[0]]
    for a, b in pairwise(truth):
        step = a.inverse() @ b
        turned = rotation_from_vector([0.0, turn_rad, 0.0]) @ step.rotation
        path.append(path[-1] @ Pose(turned, scale * step.translation))
    return path


def mean_error_m(path: list[Pose], truth: list[Pose] = TRUTH) -> float:
    return float(np.mean([position_difference_m(a, b) for a, b in zip(path, truth, strict=True)]))


# Of a wrong scale the ends of a path that nearly closes show only a part.
@pytest.mark.parametrize(
    ("scale", "turn_rad", "left"), [(1.05, 0.0, 0.85), (1.0, 0.002, 0.4), (0.96, -0.001, 0.6)]
)
def test_drift_is_taken_back_along_the_path(scale: float, turn_rad: float, left: float) -> None:
    path = drifted(scale, turn_rad)
    found = corrected_path(path, Anchored(TRUTH[0], SURE), Anchored(TRUTH[-1], SURE))
    assert mean_error_m(path) > 0.05
    assert mean_error_m(found) < left * mean_error_m(path)
    assert position_difference_m(found[-1], TRUTH[-1]) < 0.02
    assert np.degrees(attitude_difference_rad(found[-1], TRUTH[-1])) < 0.2
    steps = [position_difference_m(a, b) for a, b in pairwise(found)]
    true_m = position_difference_m(TRUTH[0], TRUTH[1])
    assert max(abs(step - true_m) for step in steps) < 0.15 * true_m


def test_a_path_that_its_fixes_agree_with_stays() -> None:
    found = corrected_path(TRUTH, Anchored(TRUTH[0], SURE), Anchored(TRUTH[-1], SURE))
    assert largest_change_m(TRUTH, found) < 1e-9


def test_a_fix_that_is_not_sure_corrects_little() -> None:
    aside = perturbed(TRUTH[-1], [0, 0, 0, 0.5, 0.0, 0.0])
    sure = corrected_path(TRUTH, Anchored(TRUTH[0], SURE), Anchored(aside, SURE))
    unsure = corrected_path(TRUTH, Anchored(TRUTH[0], SURE), Anchored(aside, Accuracy(5.0, 30.0)))
    assert largest_change_m(TRUTH, sure) > 0.4
    assert largest_change_m(TRUTH, unsure) < 0.05


def test_the_derivatives_are_those_of_the_error() -> None:
    a, b = TRUTH[3], TRUTH[9]
    motion = perturbed(a.inverse() @ b, [0.001, -0.002, 0.001, 0.01, 0.02, -0.01])
    _, by_a, by_b = relative_error(a, b, motion)
    for column in range(6):
        step = 1e-6 * np.eye(6)[column]
        of_a = (
            relative_error(perturbed(a, step), b, motion)[0]
            - relative_error(perturbed(a, -step), b, motion)[0]
        )
        of_b = (
            relative_error(a, perturbed(b, step), motion)[0]
            - relative_error(a, perturbed(b, -step), motion)[0]
        )
        # That of the turn holds for small errors.
        np.testing.assert_allclose(by_a[:, column], of_a / 2e-6, atol=5e-3)
        np.testing.assert_allclose(by_b[:, column], of_b / 2e-6, atol=5e-3)
