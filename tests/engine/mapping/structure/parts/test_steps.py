"""A scale that slides along a path is seen by points that are made before and after each step."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts.steps import UNKNOWN, scale_steps
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.se3 import Pose
from tests.engine.mapping.structure.round_walk import CAMERA, noisy_matches, true_pose

Array = NDArray[np.float64]
FRAMES = 30
BEND = 14


@pytest.fixture(scope="module")
def matched() -> MatchedPictures:
    """The matches of half of the round walk."""
    return noisy_matches(FRAMES, 0.2, seed=7)


def path(scale_after: float) -> Reconstruction:
    """Return a path that is right up to a picture, and whose steps are too long or short from there on."""
    poses = {0: true_pose(0)}
    for frame in range(1, FRAMES):
        step = true_pose(frame).translation - true_pose(frame - 1).translation
        scale = scale_after if frame > BEND else 1.0
        poses[frame] = Pose(true_pose(frame).rotation, poses[frame - 1].translation + scale * step)
    return Reconstruction(
        camera=CAMERA,
        poses=poses,
        points=np.zeros((0, 3)),
        observations=np.zeros((0, 3), np.intp),
        error_px=0.3,
    )


def test_a_right_path_has_one_scale(matched: MatchedPictures) -> None:
    steps = scale_steps(path(1.0), matched.features, matched.matches)
    assert sorted(steps) == list(range(FRAMES - 1))
    inner = [steps[row] for row in range(3, FRAMES - 4)]
    assert min(step.points for step in inner) > 20
    assert max(abs(step.log_ratio) for step in inner) < 0.02
    assert max(step.sigma for step in inner) < 0.02


@pytest.mark.parametrize("scale", [0.85, 1.2])
def test_a_scale_that_changes_is_seen_where_it_does(matched: MatchedPictures, scale: float) -> None:
    steps = scale_steps(path(scale), matched.features, matched.matches)
    largest = max(steps, key=lambda row: abs(steps[row].log_ratio) if steps[row].points > 10 else 0.0)
    assert abs(largest - BEND) <= 1
    assert steps[largest].log_ratio == pytest.approx(np.log(scale), abs=0.04)
    assert abs(steps[5].log_ratio) < 0.02


def test_a_step_that_no_point_is_seen_across_is_unknown(matched: MatchedPictures) -> None:
    apart = {pair: rows for pair, rows in matched.matches.items() if not pair[0] <= BEND < pair[1]}
    steps = scale_steps(path(1.0), matched.features, apart)
    assert steps[BEND] == UNKNOWN
    assert steps[BEND - 6].points > 20


def test_a_path_without_matches_is_unknown(matched: MatchedPictures) -> None:
    assert set(scale_steps(path(1.0), matched.features, {}).values()) == {UNKNOWN}
