"""A path is cut where it is bent, and its pieces stay together where places that are seen again tie them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts import cut
from app.engine.mapping.structure.parts.cut import (
    OPTIONS,
    broken_steps,
    cut_where_bent,
    cut_where_wrong,
    only,
)
from app.engine.mapping.structure.parts.pace import usual_speed
from app.engine.mapping.structure.parts.steps import Step, scale_steps
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.geometry.se3 import Pose, rotation_from_vector
from tests.engine.mapping.structure.parts.test_steps import BEND, FRAMES, Array, path
from tests.engine.mapping.structure.round_walk import make_wall, noisy_matches, seen_rows, true_pose


@pytest.fixture(scope="module")
def matched() -> MatchedPictures:
    return noisy_matches(FRAMES, 0.2, seed=7)


def with_points(bent: Reconstruction) -> Reconstruction:
    """Return the path with points that fit the features: those of each three pictures beside a picture's own."""
    wall = make_wall()
    points: list[Array] = []
    observations = []
    count = 0
    for row, pose in bent.poses.items():
        seen = seen_rows(wall, row)
        moved = pose.apply(true_pose(row).inverse().apply(wall[seen]))
        for other in range(max(0, row - 1), min(FRAMES, row + 2)):
            _, a, b = np.intersect1d(seen, seen_rows(wall, other), return_indices=True)
            observations.append(np.stack([np.full(len(a), other), b, a + count], axis=1))
        points.append(moved)
        count += len(seen)
    return replace(bent, points=np.concatenate(points), observations=np.concatenate(observations))


def test_a_right_path_stays_whole(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    (whole,) = cut_where_bent(right, matched.features, matched.matches, ())
    assert whole.poses.keys() == right.poses.keys()


def test_a_bent_path_is_cut_and_each_piece_is_right(matched: MatchedPictures) -> None:
    bent = with_points(path(1.25))
    first, *others = cut_where_bent(bent, matched.features, matched.matches, ())
    pieces = [sorted(first.poses), *(sorted(other.poses) for other in others)]
    assert [rows for rows in pieces if rows[0] <= BEND < rows[-1]] == []
    assert sum(map(len, pieces)) >= FRAMES - 4
    assert set(first.observations[:, 0]) == set(first.poses)
    assert set(first.observations[:, 2]) == set(range(len(first.points)))


def test_pieces_that_see_a_place_again_stay_together(matched: MatchedPictures) -> None:
    bent = with_points(path(1.25))
    ties = [(number, number + 20) for number in range(1, 1 + OPTIONS.min_ties)]
    (whole,) = cut_where_bent(bent, matched.features, matched.matches, ties)
    assert {0, FRAMES - 1} <= whole.poses.keys()
    assert len(cut_where_bent(bent, matched.features, matched.matches, ties[1:])) > 1


def test_a_path_is_cut_where_nothing_carries_the_scale(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    apart = {pair: rows for pair, rows in matched.matches.items() if not pair[0] <= BEND < pair[1]}
    pieces = cut_where_bent(right, matched.features, apart, ())
    # Beside the cut too few pictures are left for points on both sides of a step.
    assert sorted(sorted(piece.poses) for piece in pieces) == [
        list(range(BEND)),
        list(range(BEND + 2, FRAMES)),
    ]


def test_an_end_beyond_pictures_that_are_left_out_is_left_out_too(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    between = (FRAMES - 8, FRAMES - 3)
    apart = {
        pair: rows
        for pair, rows in matched.matches.items()
        if not any(pair[0] <= cut < pair[1] for cut in between)
    }
    (piece,) = cut_where_bent(right, matched.features, apart, ())
    assert 0 in piece.poses
    assert not any(row > FRAMES - 8 for row in piece.poses)


def test_few_pictures_between_pieces_that_are_tied_stay_in_the_path(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    between = (BEND, BEND + 4)
    apart = {
        pair: rows
        for pair, rows in matched.matches.items()
        if not any(pair[0] <= cut < pair[1] for cut in between)
    }
    ties = [(number, number + 20) for number in range(1, 1 + OPTIONS.min_ties)]
    assert cut_where_bent(right, matched.features, apart, ties)[0].poses.keys() == right.poses.keys()
    pieces = cut_where_bent(right, matched.features, apart, ())
    assert not any(BEND + 2 in piece.poses for piece in pieces)


def test_a_picture_whose_points_do_not_fit_is_left_out(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    turned = Pose(rotation_from_vector([0, 0, np.radians(2.0)]), np.zeros(3)) @ right.poses[10]
    wrong = replace(right, poses={**right.poses, 10: turned})
    pieces = cut_where_bent(wrong, matched.features, matched.matches, ())
    assert len(pieces) == 2
    assert not any(10 in piece.poses for piece in pieces)


def test_points_that_other_pictures_made_are_left_out() -> None:
    """Each picture's own points are seen by it alone, those of the wall by all that it sees."""
    wall = make_wall()
    rows = [(row, number, point) for row in range(4) for number, point in enumerate(seen_rows(wall, row))]
    whole = replace(path(1.0), points=wall, observations=np.array(rows, np.intp))
    kept = only(whole, [2, 3])
    both = set(seen_rows(wall, 2)) & set(seen_rows(wall, 3))
    assert 20 < len(kept.points) <= len(both)
    assert sorted(np.bincount(kept.observations[:, 2]).tolist()) == [2] * len(kept.points)
    seen = kept.observations[kept.observations[:, 0] == 2]
    expected = {tuple(wall[seen_rows(wall, 2)[number]]) for number in seen[:, 1]}
    assert {tuple(point) for point in kept.points[seen[:, 2]]} == expected
    assert len(only(whole, [2]).points) == 0


def test_one_step_alone_is_no_bend_and_few_points_are_no_step() -> None:
    steps = {row: Step(100, 0.0, 0.004) for row in range(9)}
    steps[4] = Step(100, 0.3, 0.004)
    assert broken_steps(steps) == []
    steps[5] = Step(100, 0.2, 0.004)
    assert broken_steps(steps) == [4, 5]
    steps[4] = Step(OPTIONS.min_points - 1, 0.0, 0.004)
    steps[5] = Step(100, 0.0, 1.1 * OPTIONS.max_sigma)
    assert broken_steps(steps) == [4, 5]


TIMES_S = [0.5 * row for row in range(FRAMES)]


def test_a_path_that_no_person_walks_is_cut_at_its_leaps(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    (whole,) = cut_where_wrong(right, matched.features, matched.matches, TIMES_S)
    assert whole is right
    first, last = 10, 19
    away = Pose(np.eye(3), np.array([0.0, 0.0, 20.0 * usual_speed(right.poses, TIMES_S)]))
    moved = {row: away @ pose if first <= row <= last else pose for row, pose in right.poses.items()}
    astray = replace(right, poses=moved)
    assert rows_of(cut_where_wrong(astray, matched.features, {}, TIMES_S)) == [
        list(range(first)),
        list(range(first, last + 1)),
        list(range(last + 1, FRAMES)),
    ]


def test_a_wrong_path_is_cut_at_its_gaps_in_time_too(matched: MatchedPictures) -> None:
    right = with_points(path(1.0))
    later = [time + (60.0 if row >= 20 else 0.0) for row, time in enumerate(TIMES_S)]
    assert len(cut_where_wrong(right, matched.features, {}, later)) == 1
    away = Pose(np.eye(3), np.array([0.0, 0.0, 20.0 * usual_speed(right.poses, TIMES_S)]))
    astray = replace(
        right, poses={row: away @ pose if row >= 10 else pose for row, pose in right.poses.items()}
    )
    assert rows_of(cut_where_wrong(astray, matched.features, {}, later)) == [
        list(range(10)),
        list(range(10, 20)),
        list(range(20, FRAMES)),
    ]


def test_a_path_is_cut_where_many_points_disagree_on_the_scale(
    matched: MatchedPictures, monkeypatch: pytest.MonkeyPatch
) -> None:
    bent = with_points(path(1.25))
    most = max(step.points for step in scale_steps(bent, matched.features, matched.matches).values())
    assert cut_where_wrong(bent, matched.features, matched.matches, TIMES_S) == [bent]
    monkeypatch.setattr(cut, "OPTIONS", replace(OPTIONS, sure_points=most // 3))
    pieces = rows_of(cut_where_wrong(bent, matched.features, matched.matches, TIMES_S))
    assert len(pieces) > 1
    assert [rows for rows in pieces if rows[0] <= BEND - 2 and rows[-1] >= BEND + 3] == []


def rows_of(pieces: Sequence[Reconstruction]) -> list[list[int]]:
    return sorted(sorted(piece.poses) for piece in pieces)
