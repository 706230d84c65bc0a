"""Drift that is added is as large as it is asked for, and errors are measured against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from app.geometry.se3 import Pose, position_difference_m
from bench.drift.measure import error_m
from bench.drift.odometry import measured_drift, with_drift
from tests.scenes import pose_at

WAY = [pose_at(0.2 * k, np.sin(0.05 * k), 1.4, 10 * np.cos(0.05 * k)) for k in range(150)]


@pytest.mark.parametrize("ratio", [0.01, 0.05])
def test_drift_is_as_large_as_asked_for(ratio: float) -> None:
    path = with_drift(WAY, ratio)
    assert measured_drift(WAY, path) == pytest.approx(ratio, rel=0.01)
    assert position_difference_m(path[0], WAY[0]) == 0
    assert error_m(path, WAY) > 0.1 * ratio * 30


def test_draws_differ_and_repeat_themselves() -> None:
    def ends(seed: int) -> float:
        return position_difference_m(with_drift(WAY, 0.01, seed)[-1], WAY[-1])

    assert ends(0) == ends(0) != ends(1)


def test_errors_are_those_left_after_a_rigid_alignment() -> None:
    turned = pose_at(3.0, -2.0, 0.5, 40.0)
    assert error_m([turned @ pose for pose in WAY], WAY) < 1e-9
    stretched = [Pose(pose.rotation, 1.1 * pose.translation) for pose in WAY]
    assert error_m(stretched, WAY) > 0.5
