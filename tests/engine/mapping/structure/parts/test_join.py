"""Parts of a path are joined where their pictures agree, and not where a place only looks like another one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure.estimate import check_joined
from app.engine.mapping.structure.floor.levels import Floor
from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.engine.mapping.structure.parts.join import join_parts
from app.engine.mapping.structure.parts.links import Tie, agreeing_ties
from app.engine.mapping.structure.parts.pace import is_walk
from app.engine.mapping.structure.parts.placed import with_placed
from app.engine.mapping.structure.parts.similarity import Similarity, average_similarity
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.sequence import Path3D, without_insides
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.alignment import align_points
from app.geometry.se3 import Pose, rotation_from_vector
from app.vision.features import LocalFeatures
from tests.engine.mapping.structure.round_walk import CAMERA, COPY, FRAMES, make_wall, seen_rows, true_pose

Array = NDArray[np.float64]
TIMES_S = [0.4 * frame for frame in range(FRAMES)]
# How the second part lies: turned, moved, and three times as large.
MOVED = Similarity(Pose(rotation_from_vector([0.3, -0.2, 1.1]), np.array([4.0, -7.0, 2.0])), 3.0)


@pytest.fixture(scope="module")
def wall() -> Array:
    return make_wall()


@pytest.fixture(scope="module")
def seen(wall: Array) -> list[NDArray[np.intp]]:
    return [seen_rows(wall, frame) for frame in range(FRAMES)]


def part_of(
    frames: Iterable[int], wall: Array, seen: list[NDArray[np.intp]], own: Similarity
) -> Reconstruction:
    """Return the part of some frames, in a frame and unit of its own."""
    rows = [(frame, number, point) for frame in frames for number, point in enumerate(seen[frame])]
    return Reconstruction(
        camera=CAMERA,
        poses={frame: own.move(true_pose(frame)) for frame in frames},
        points=own.apply(wall),
        observations=np.array(rows, np.intp),
        error_px=0.3,
    )


def matched_pictures(
    wall: Array, seen: list[NDArray[np.intp]], steps: Iterable[tuple[Pair, int]]
) -> MatchedPictures:
    """Return the matches of pairs of frames, each with how far the second one's points are after the first one's."""
    features = [
        LocalFeatures(
            CAMERA.project(true_pose(frame).inverse().apply(wall[own])).astype(np.float32),
            np.zeros((len(own), 1), np.float32),
        )
        for frame, own in enumerate(seen)
    ]
    matches = {}
    for (i, j), shift in steps:
        _, a, b = np.intersect1d(seen[i] + shift, seen[j], return_indices=True)
        matches[i, j] = np.stack([a, b], axis=1)
    return MatchedPictures(tuple(features), matches)


def beside(reach: int) -> list[tuple[Pair, int]]:
    return [((i, i + step), 0) for step in range(1, reach + 1) for i in range(FRAMES - step)]


def error_m(part: Reconstruction) -> float:
    """Return the largest error of the positions after one alignment."""
    found = np.array([pose.translation for pose in part.poses.values()])
    true = np.array([true_pose(frame).translation for frame in part.poses])
    own = align_points(found, true, with_scale=True)
    aligned = own.scale * found @ own.target_from_source.rotation.T + own.target_from_source.translation
    return float(np.linalg.norm(aligned - true, axis=1).max())


def test_parts_of_different_scale_are_joined_and_the_pictures_between_placed(
    wall: Array, seen: list[NDArray[np.intp]]
) -> None:
    parts = [
        part_of(range(15), wall, seen, MOVED),
        part_of(range(17, 40), wall, seen, Similarity.identity()),
    ]
    matched = matched_pictures(wall, seen, beside(6))
    ((whole, joined),) = join_parts(parts, matched, TIMES_S, NoProgress())
    assert joined == 2
    assert sorted(whole.poses) == [*range(15), *range(17, 40)]
    assert error_m(whole) < 0.02
    placed = with_placed(whole, matched, TIMES_S)
    assert {15, 16} <= placed.poses.keys()
    assert error_m(placed) < 0.02
    assert np.isin([15, 16], placed.observations[:, 0]).all()


def test_a_copy_of_a_place_joins_no_parts(wall: Array, seen: list[NDArray[np.intp]]) -> None:
    """All pictures of the first part match as if the second one were where it began: the camera would have to leap."""
    parts = [part_of(range(19), wall, seen, MOVED), part_of(range(20, 39), wall, seen, Similarity.identity())]
    copies = [((k, k + COPY), 3000) for k in range(19)]
    found = join_parts(parts, matched_pictures(wall, seen, copies), TIMES_S, NoProgress())
    assert [joined for _, joined in found] == [1, 1]
    # The same matches join them where there was time to walk back.
    later = [*TIMES_S[:20], *(time_s + 60 for time_s in TIMES_S[20:])]
    ((_, joined),) = join_parts(parts, matched_pictures(wall, seen, copies), later, NoProgress())
    assert joined == 2


def test_what_most_pictures_say_outvotes_a_copy(wall: Array, seen: list[NDArray[np.intp]]) -> None:
    parts = [part_of(range(19), wall, seen, MOVED), part_of(range(20, 39), wall, seen, Similarity.identity())]
    few = [((k, k + COPY), 3000) for k in range(2)]
    ((whole, joined),) = join_parts(
        parts, matched_pictures(wall, seen, [*beside(6), *few]), TIMES_S, NoProgress()
    )
    assert joined == 2
    assert error_m(whole) < 0.02


def test_a_picture_is_not_placed_where_it_could_not_have_been(
    wall: Array, seen: list[NDArray[np.intp]]
) -> None:
    part = part_of(range(19), wall, seen, Similarity.identity())
    matched = matched_pictures(wall, seen, [((k, 20), 3000) for k in range(4)])
    assert 20 not in with_placed(part, matched, TIMES_S).poses
    # Much later nothing is known of where it may be.
    later = [*TIMES_S[:20], *(time_s + 60 for time_s in TIMES_S[20:])]
    assert 20 not in with_placed(part, matched, later).poses
    near = matched_pictures(wall, seen, [((k, 20), 0) for k in range(16, 19)])
    assert 20 in with_placed(part, near, TIMES_S).poses


def test_pictures_inside_of_another_part_are_not_found_anew(
    wall: Array, seen: list[NDArray[np.intp]]
) -> None:
    """Only the ends of the part from 10 to 39, and what is known inside of it, keep their matches."""
    part = part_of(range(10, 40), wall, seen, MOVED)
    matches = {(i, i + 1): np.zeros((0, 2), np.intp) for i in range(50)}
    left = without_insides(matches, [part], {20: true_pose(20), 21: true_pose(21)})
    assert sorted(left) == [*((i, i + 1) for i in range(15)), (20, 21), *((i, i + 1) for i in range(34, 50))]


def test_where_a_path_broke_is_said_in_seconds(wall: Array, seen: list[NDArray[np.intp]]) -> None:
    parts = [part_of([*range(5, 15), 20], wall, seen, MOVED), part_of(range(16, 20), wall, seen, MOVED)]
    said = Path3D(parts, None).where_it_broke([float(frame) for frame in range(23)])
    assert "fell into 2 parts" in said
    assert "11 of 23 chosen pictures and leaves out 0 to 4 s, 15 to 19 s, 21 to 22 s." in said


def ties(scales: Iterable[float]) -> list[Tie]:
    """Return pictures that agree but for the ratio of the scales."""
    return [
        Tie(row, true_pose(row), replace(MOVED, scale=3.0 * scale).move(true_pose(row)), 3.0 * scale)
        for row, scale in enumerate(scales)
    ]


def test_a_path_of_joined_parts_must_hold_most_of_the_pictures(
    wall: Array, seen: list[NDArray[np.intp]]
) -> None:
    part = part_of(range(14), wall, seen, MOVED)
    check_joined(Path3D([part], None, joined=2), list(range(15)), None)
    with pytest.raises(InvalidScanError, match=r"88% of them in 2 joined parts the path may be bent"):
        check_joined(Path3D([part], None, joined=2), list(range(16)), None)
    # One part that leaves as much out was not joined to anything.
    check_joined(Path3D([part], None), list(range(21)), None)


def test_less_of_a_path_is_enough_at_one_height_above_a_level_floor(
    wall: Array, seen: list[NDArray[np.intp]]
) -> None:
    path = Path3D([part_of(range(14), wall, seen, MOVED)], None, joined=2)
    level = np.zeros(9)
    floor = Floor(
        up=np.array([0, 0, 1.0]),
        level=0.0,
        height=1.5,
        points=np.zeros(1, np.intp),
        roughness=np.zeros(1),
        above=level,
        held=1.0 + level,
    )
    check_joined(path, list(range(17)), floor)
    with pytest.raises(InvalidScanError, match=r"78% of them"):
        check_joined(path, list(range(18)), floor)
    for moving in ({"held": np.linspace(1.0, 1.1, 9)}, {"above": np.linspace(0.0, 0.1, 9)}):
        with pytest.raises(InvalidScanError, match=r"82% of them"):
            check_joined(path, list(range(17)), replace(floor, **moving))


def test_a_part_that_broke_inside_lies_nowhere() -> None:
    assert len(agreeing_ties(ties([1.0, 1.01, 0.99, 1.02]), 6.0)) == 4
    assert len(agreeing_ties(ties([1.0, 1.01, 0.99, 1.6]), 6.0)) == 3
    assert agreeing_ties(ties([1.0, 1.01, 1.5, 2.5, 3.4]), 6.0) == []


def test_a_walk_moves_evenly_over_a_seam() -> None:
    first = {frame: true_pose(frame) for frame in range(10)}
    second = {frame: true_pose(frame) for frame in range(11, 20)}
    assert is_walk(first, second, TIMES_S, 0.1)
    away = Pose(np.eye(3), np.array([0.0, 0.0, 5.0]))
    assert not is_walk(first, {row: away @ pose for row, pose in second.items()}, TIMES_S, 0.1)
    around = Pose(rotation_from_vector([0.0, 0.0, np.pi]), np.zeros(3))
    turned = {row: Pose((around @ pose).rotation, pose.translation) for row, pose in second.items()}
    assert not is_walk(first, turned, TIMES_S, 0.1)


def test_similarities_compose_and_invert() -> None:
    other = Similarity(Pose(rotation_from_vector([-1.0, 0.4, 0.2]), np.array([1.0, 2.0, 3.0])), 0.4)
    points = np.random.default_rng(1).normal(size=(5, 3))
    assert (MOVED @ other).apply(points) == pytest.approx(MOVED.apply(other.apply(points)))
    assert MOVED.inverse().apply(MOVED.apply(points)) == pytest.approx(points)
    own = [true_pose(frame) for frame in range(5)]
    found = average_similarity(own, [MOVED.move(pose) for pose in own], np.full(5, 3.0))
    assert found.apply(points) == pytest.approx(MOVED.apply(points))
    lone = Similarity.of_camera(own[0], MOVED.move(own[0]), 3.0)
    assert lone.apply(points) == pytest.approx(MOVED.apply(points))
