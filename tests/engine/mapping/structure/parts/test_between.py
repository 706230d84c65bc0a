"""A piece of a walk between two known stretches is placed by its ends, and left out where they contradict it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts import between
from app.engine.mapping.structure.parts.between import with_pieces_between
from app.engine.mapping.structure.parts.similarity import Similarity
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.se3 import Pose, attitude_difference_rad, position_difference_m, rotation_from_vector
from tests.engine.mapping.structure.parts.test_cut import with_points
from tests.engine.mapping.structure.parts.test_steps import FRAMES, path
from tests.engine.mapping.structure.round_walk import WALL_RADIUS_M, noisy_matches

TIMES_S = [0.2 * row for row in range(FRAMES)]
# The pictures of the piece; the others are known.
PIECE = range(10, 23)
# How the piece's own frame lies.
AWAY = Similarity(Pose(rotation_from_vector([0.4, -1.1, 0.7]), np.array([3.0, -5.0, 1.0])), 2.3)


@pytest.fixture(scope="module")
def matched() -> MatchedPictures:
    return noisy_matches(FRAMES, 0.2, seed=7)


@pytest.fixture(scope="module")
def right() -> Reconstruction:
    return with_points(path(1.0))


def part_of(whole: Reconstruction, rows: list[int], moved: Similarity | None = None) -> Reconstruction:
    """Return some pictures of a path with the points that they see, in a frame of their own."""
    seen = whole.observations[np.isin(whole.observations[:, 0], rows)]
    numbers, own = np.unique(seen[:, 2], return_inverse=True)
    points = whole.points[numbers]
    poses = {row: whole.poses[row] for row in rows}
    if moved is not None:
        points, poses = moved.apply(points), {row: moved.move(pose) for row, pose in poses.items()}
    return replace(whole, poses=poses, points=points, observations=np.column_stack([seen[:, :2], own]))


def known(whole: Reconstruction) -> Reconstruction:
    return part_of(whole, [row for row in range(FRAMES) if row not in PIECE])


def off_m(found: Reconstruction, right: Reconstruction, rows: Iterable[int]) -> float:
    return max(position_difference_m(found.poses[row], right.poses[row]) for row in rows)


def test_a_piece_is_placed_by_its_ends(matched: MatchedPictures, right: Reconstruction) -> None:
    parts = [part_of(right, list(PIECE), AWAY), known(right)]
    (found,), placed = with_pieces_between(parts, matched, TIMES_S)
    assert placed == 1
    assert found.poses.keys() == right.poses.keys()
    assert off_m(found, right, PIECE) < 0.1
    assert max(attitude_difference_rad(found.poses[row], right.poses[row]) for row in PIECE) < np.radians(2)
    # Its points are where those of the others are.
    new = found.points[len(parts[1].points) :]
    assert np.abs(np.linalg.norm(new[:, :2], axis=1) - WALL_RADIUS_M).max() < 1.2


def test_a_piece_whose_end_is_torn_off_is_placed_without_it(
    matched: MatchedPictures, right: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The gap is longer then, and the walk of this test short.
    monkeypatch.setattr(between, "OPTIONS", replace(between.OPTIONS, min_length_ratio=3.0))
    away = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    last = max(PIECE)
    torn = replace(right, poses={**right.poses, last: away @ right.poses[last]})
    (found,), placed = with_pieces_between([known(right), part_of(torn, list(PIECE), AWAY)], matched, TIMES_S)
    assert placed == 1
    assert last not in found.poses
    assert off_m(found, right, found.poses) < 0.15


def test_what_the_rest_has_of_the_pieces_own_time_is_left_out(
    matched: MatchedPictures, right: Reconstruction
) -> None:
    middle = 16
    away = Pose(np.eye(3), np.array([0.0, 0.0, 3.0]))
    wrong = replace(right, poses={**right.poses, middle: away @ right.poses[middle]})
    others = part_of(wrong, [row for row in range(FRAMES) if row not in PIECE or row == middle])
    (found,), placed = with_pieces_between([others, part_of(right, list(PIECE), AWAY)], matched, TIMES_S)
    assert placed == 1
    assert off_m(found, right, PIECE) < 0.1


def bent(right: Reconstruction) -> Reconstruction:
    """Return the path with the piece's second half turned against its first by 15 degrees."""
    turn = Pose(rotation_from_vector([0, 0, np.radians(15)]), np.zeros(3))
    middle = Pose(np.eye(3), right.poses[16].translation)
    about = middle @ turn @ middle.inverse()
    return replace(
        right, poses={row: about @ pose if row > 16 else pose for row, pose in right.poses.items()}
    )


REFUSED = {
    "bent": lambda right: (known(right), part_of(bent(right), list(PIECE), AWAY), TIMES_S),
    "the walk goes on elsewhere": lambda right: (
        known(right),
        part_of(right, list(PIECE), AWAY),
        [time + 5.0 * (row > max(PIECE)) for row, time in enumerate(TIMES_S)],
    ),
    "at the end": lambda right: (
        part_of(right, list(range(16))),
        part_of(right, list(range(16, FRAMES)), AWAY),
        TIMES_S,
    ),
    "too short": lambda right: (
        part_of(right, [row for row in range(FRAMES) if row not in range(10, 16)]),
        part_of(right, list(range(10, 16)), AWAY),
        TIMES_S,
    ),
    "too fast": lambda right: (
        known(right),
        part_of(right, list(PIECE), AWAY),
        [0.2 * row - 0.12 * min(max(row - min(PIECE), 0), len(PIECE) - 1) for row in range(FRAMES)],
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_piece_whose_ends_do_not_tell_is_left_out(
    matched: MatchedPictures, right: Reconstruction, kind: str
) -> None:
    whole, piece, times_s = REFUSED[kind](right)
    parts, placed = with_pieces_between([whole, piece], matched, times_s)
    assert placed == 0
    assert [part.poses.keys() for part in parts] == [whole.poses.keys(), piece.poses.keys()]


def test_nothing_is_placed_in_nothing(matched: MatchedPictures) -> None:
    assert with_pieces_between([], matched, TIMES_S) == ([], 0)


def test_without_matches_over_a_gap_the_turn_is_not_known(
    matched: MatchedPictures, right: Reconstruction
) -> None:
    last = max(PIECE)
    apart = {pair: rows for pair, rows in matched.matches.items() if not pair[0] <= last < pair[1]}
    parts = [known(right), part_of(right, list(PIECE), AWAY)]
    assert with_pieces_between(parts, replace(matched, matches=apart), TIMES_S)[1] == 0
