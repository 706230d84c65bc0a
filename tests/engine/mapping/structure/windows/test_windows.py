"""Stretches of a video: motions before plain walls, who decides between two, and parts that overlap."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.windows import reconstruct as windows
from app.engine.mapping.structure.windows.motions import Motion, motions_of
from app.engine.mapping.structure.windows.reconstruct import reconstruct_windows
from app.engine.mapping.structure.windows.voted import voted_motions
from app.engine.progress import NoProgress
from app.geometry.alignment import align_points
from app.geometry.estimators.relative_refinement import RelativePoseProblem
from app.geometry.se3 import Pose, rotation_angle_deg, rotation_from_vector
from tests.engine.mapping.structure.round_walk import (
    CAMERA,
    FRAMES,
    noisy_matches,
    true_pose,
)

Array = NDArray[np.float64]
A_FROM_B = Pose(rotation_from_vector([0.02, 0.22, 0.01]), np.array([0.35, -0.05, 0.2]))


def seen_by_both(points: Array) -> tuple[Array, Array]:
    """Return the pixels of points in front of the first of two cameras, with half a pixel of noise."""
    rng = np.random.default_rng(3)
    pixels = CAMERA.project(points), CAMERA.project(A_FROM_B.inverse().apply(points))
    inside = [
        np.isfinite(own).all(axis=1) & (own > 0).all(axis=1) & (own < [640, 480]).all(axis=1)
        for own in pixels
    ]
    a, b = (own[inside[0] & inside[1]] for own in pixels)
    return a + rng.normal(0, 0.3, a.shape), b + rng.normal(0, 0.3, b.shape)


def wrong_turns_deg(motions: Iterable[Motion]) -> list[float]:
    return [rotation_angle_deg(motion.b_from_a.rotation @ A_FROM_B.rotation) for motion in motions]


def test_a_plain_wall_allows_two_motions_and_a_room_one() -> None:
    rng = np.random.default_rng(2)
    across = rng.uniform(-2, 2, (400, 2))
    wall = np.column_stack([across, 3.0 + 0.4 * across[:, 0]])
    found = wrong_turns_deg(motions_of(*seen_by_both(wall), CAMERA, 15))
    assert len(found) == 2
    assert min(found) < 0.5
    assert max(found) > 2.0
    room = np.column_stack([across, rng.uniform(2, 6, 400)])
    (only,) = wrong_turns_deg(motions_of(*seen_by_both(room), CAMERA, 15))
    assert only < 0.2


def test_few_matches_are_no_motion() -> None:
    rng = np.random.default_rng(2)
    a, b = seen_by_both(np.column_stack([rng.uniform(-2, 2, (400, 2)), rng.uniform(2, 6, 400)]))
    assert motions_of(a[:14], b[:14], CAMERA, 15) == []


def test_a_motion_that_can_not_be_refined_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    across = np.random.default_rng(2).uniform(-2, 2, (400, 2))
    wall = np.column_stack([across, 3.0 + 0.4 * across[:, 0]])

    def fails(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(RelativePoseProblem, "refined", fails)
    assert len(motions_of(*seen_by_both(wall), CAMERA, 15)) == 1


def turn(degrees: float) -> Motion:
    rotation = rotation_from_vector([0.0, np.radians(degrees), 0.0])
    return Motion(Pose(rotation, np.array([1.0, 0.0, 0.0])), np.ones(20, np.bool_))


def test_third_pictures_decide_between_two_motions() -> None:
    """Each picture turns by 10 degrees; the pair in the middle has a wrong motion with more inliers."""
    motions = {(i, j): [turn(10.0 * (j - i))] for i in range(6) for j in range(i + 1, min(6, i + 4))}
    motions[2, 3] = [turn(25.0), turn(10.0)]
    motions[1, 3] = [turn(48.0), turn(20.0)]
    chosen = voted_motions(motions)
    assert chosen[2, 3] is motions[2, 3][1]
    assert chosen[1, 3] is motions[1, 3][1]


def test_of_two_motions_that_fit_alike_the_one_with_more_inliers_is_taken() -> None:
    motions = {(0, 1): [turn(10.0)], (1, 2): [turn(10.0)], (0, 2): [turn(20.1), turn(20.0)]}
    assert voted_motions(motions)[0, 2] is motions[0, 2][0]


@pytest.fixture(scope="module")
def matched() -> MatchedPictures:
    """The matches of each picture of the round walk with the next three."""
    return noisy_matches(FRAMES, 0.3, seed=6)


TIMES_S = [0.5 * frame for frame in range(FRAMES)]


def error_m(part: Reconstruction) -> float:
    """Return the largest error of the positions after one alignment."""
    found = np.array([pose.translation for pose in part.poses.values()])
    true = np.array([true_pose(frame).translation for frame in part.poses])
    own = align_points(found, true, with_scale=True)
    aligned = own.scale * found @ own.target_from_source.rotation.T + own.target_from_source.translation
    return float(np.linalg.norm(aligned - true, axis=1).max())


@pytest.fixture
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(windows.OPTIONS, pictures=24, stride=14, calibrated_on=30)
    monkeypatch.setattr(windows, "OPTIONS", short)


@pytest.mark.usefixtures("_short")
@pytest.mark.parametrize("is_calibrated", [True, False])
def test_stretches_overlap_and_each_is_right(matched: MatchedPictures, is_calibrated: bool) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    parts = reconstruct_windows(
        matched, CAMERA, TIMES_S, is_calibrated=is_calibrated, scratch=None, progress=NoProgress()
    )
    assert len(parts) >= 4
    assert set().union(*(part.poses for part in parts)) == set(range(FRAMES))
    assert max(len(part.poses) for part in parts) == 24
    assert max(map(error_m, parts)) < 0.1
    assert max(abs(part.camera.focal_px / CAMERA.focal_px - 1) for part in parts) < 0.02


@pytest.mark.usefixtures("_short")
def test_no_stretch_holds_a_step_that_no_person_makes(matched: MatchedPictures) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    # Half a second's way within a thousandth of one.
    hasty = [time - (0.499 if frame > 30 else 0.0) for frame, time in enumerate(TIMES_S)]
    parts = reconstruct_windows(
        matched, CAMERA, hasty, is_calibrated=True, scratch=None, progress=NoProgress()
    )
    assert [part for part in parts if {30, 31} <= part.poses.keys()] == []
    assert set().union(*(part.poses for part in parts)) == set(range(FRAMES))
