"""A video's path is tied where it comes back to a place, and not where another place looks the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.structure import joined
from app.engine.mapping.structure import sequence as path_of_sequence
from app.engine.mapping.structure.joined import rejoined
from app.engine.mapping.structure.matches import MatchedPictures, Pair
from app.engine.mapping.structure.reconstruction import Reconstruction
from app.engine.mapping.structure.revisits import Revisits, find_revisits
from app.engine.mapping.structure.sequence import reconstruct_sequence
from app.engine.mapping.structure.up import DownDirection
from app.engine.mapping.structure.windows import reconstruct as windows
from app.engine.progress import NoProgress
from app.errors import CancelledBuildError
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures
from tests.engine.mapping.structure.round_walk import (
    CAMERA,
    COPY,
    FRAMES,
    TURN,
    WALK_RADIUS_M,
    drifted_pose,
    make_wall,
    seen_rows,
    true_pose,
)

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def wall() -> Array:
    return make_wall()


@pytest.fixture(scope="module")
def structure(wall: Array) -> tuple[Reconstruction, MatchedPictures]:
    """The drifted path with each frame's own points, and matches of a place with itself and with its copy."""
    rows = [seen_rows(wall, frame) for frame in range(FRAMES)]
    local = [true_pose(frame).inverse().apply(wall[own]) for frame, own in enumerate(rows)]
    features = tuple(
        LocalFeatures(CAMERA.project(points).astype(np.float32), np.zeros((len(points), 1), np.float32))
        for points in local
    )
    counts = np.array([len(own) for own in rows])
    observations = np.stack(
        [
            np.repeat(np.arange(FRAMES), counts),
            np.concatenate([np.arange(n) for n in counts]),
            np.arange(counts.sum()),
        ],
        axis=1,
    )
    poses = {frame: drifted_pose(frame) for frame in range(FRAMES)}
    points = np.concatenate([poses[frame].apply(own) for frame, own in enumerate(local)])
    part = Reconstruction(camera=CAMERA, poses=poses, points=points, observations=observations, error_px=0.3)
    matches = {}
    for i, j in [*((k, k + TURN) for k in range(6)), *((k, k + COPY) for k in range(6))]:
        # The copy's points are the next 3,000.
        wanted = rows[i] if j - i == TURN else rows[i] + 3000
        _, a, b = np.intersect1d(wanted, rows[j], return_indices=True)
        matches[i, j] = np.stack([a, b], axis=1)
    return part, MatchedPictures(features, matches)


def end_error_m(poses: dict[int, Pose]) -> float:
    """Return by how far the motion from the first frame to the last is wrong."""
    by_poses = poses[0].inverse() @ poses[FRAMES - 1]
    truth = true_pose(0).inverse() @ true_pose(FRAMES - 1)
    return float(np.linalg.norm(by_poses.translation - truth.translation))


@pytest.fixture(scope="module")
def revisits(structure: tuple[Reconstruction, MatchedPictures]) -> Revisits:
    part, matched = structure
    return find_revisits(part, matched, sorted(matched.matches), NoProgress())


def test_a_place_that_only_looks_the_same_ties_nothing(revisits: Revisits) -> None:
    assert set(revisits.agreeing) == {(k, k + TURN) for k in range(6)}
    assert revisits.measured > 6
    shown = revisits.as_dict()
    assert (shown["compared"], shown["within_drift"], shown["agreeing"]) == (12, 6, 6)


def test_the_path_is_corrected_by_what_it_sees_twice(
    structure: tuple[Reconstruction, MatchedPictures], revisits: Revisits
) -> None:
    assert end_error_m(structure[0].poses) > 0.2
    assert end_error_m(revisits.poses) < 0.05


def test_what_the_other_loops_contradict_ties_nothing(
    structure: tuple[Reconstruction, MatchedPictures],
) -> None:
    """A frame that sees what another one saw 1.3 m before: its drift would be possible, but not with theirs."""
    part, matched = structure
    late, before = 63, TURN
    features = tuple(matched.features[before if row == late else row] for row in range(FRAMES))
    seen = part.observations[part.observations[:, 0] == before]
    local = part.poses[before].inverse().apply(part.points[seen[:, 2]])
    rows = np.arange(len(seen)) + len(part.points)
    added = np.stack([np.full(len(seen), late), seen[:, 1], rows], axis=1)
    others = part.observations[part.observations[:, 0] != late]
    changed = replace(
        part,
        points=np.concatenate([part.points, part.poses[late].apply(local)]),
        observations=np.concatenate([others, added]),
    )
    matches = {pair: rows for pair, rows in matched.matches.items() if late not in pair}
    matches[0, late] = matched.matches[0, before]
    found = find_revisits(changed, MatchedPictures(features, matches), sorted(matches), NoProgress())
    assert found.within_drift == 6
    assert set(found.agreeing) == {(k, k + TURN) for k in range(6) if k + TURN != late}


def test_pairs_outside_of_the_part_say_nothing(structure: tuple[Reconstruction, MatchedPictures]) -> None:
    part, matched = structure
    few = replace(part, poses={row: pose for row, pose in part.poses.items() if row < TURN})
    rows = few.observations[:, 0] < TURN
    found = find_revisits(
        replace(few, observations=few.observations[rows]), matched, sorted(matched.matches), NoProgress()
    )
    assert (found.compared, found.agreeing) == (6, ())


def sequence(wall: Array, copies: bool) -> MatchedPictures:
    """Return the matches of frames that are beside each other, of a place with itself, and with its copy."""
    rows = [seen_rows(wall, frame) for frame in range(FRAMES)]
    rng = np.random.default_rng(6)
    features = []
    for frame, own in enumerate(rows):
        pixels = CAMERA.project(true_pose(frame).inverse().apply(wall[own]))
        noisy = (pixels + rng.normal(0, 0.3, pixels.shape)).astype(np.float32)
        features.append(LocalFeatures(noisy, np.zeros((len(own), 1), np.float32)))
    steps: list[tuple[Pair, int]] = [((i, i + step), 0) for step in (1, 2, 3) for i in range(FRAMES - step)]
    steps += [((k, k + TURN), 0) for k in range(6)]
    steps += [((k, k + COPY), 3000) for k in range(6)] if copies else []
    matches = {}
    for (i, j), shift in steps:
        _, a, b = np.intersect1d(rows[i] + shift, rows[j], return_indices=True)
        if len(a) >= 20:
            matches[i, j] = np.stack([a, b], axis=1)
    return MatchedPictures(tuple(features), matches)


@pytest.mark.parametrize("in_stretches", [False, True])
def test_a_copy_of_a_place_does_not_fold_the_path(
    wall: Array, in_stretches: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    if in_stretches:
        short = replace(windows.OPTIONS, pictures=24, stride=14, calibrated_on=30)
        monkeypatch.setattr(windows, "OPTIONS", short)
    matched = sequence(wall, copies=True)
    found = reconstruct_sequence(
        matched,
        CAMERA,
        range(FRAMES),
        lambda part: None,
        is_calibrated=True,
        scratch=None,
        progress=NoProgress(),
    )
    (whole,) = found.parts
    assert found.revisits is not None
    assert set(found.revisits.agreeing) == {(k, k + TURN) for k in range(6)}
    assert len(whole.poses) == FRAMES
    assert (found.joined > 1) is in_stretches
    across = np.linalg.norm(whole.poses[0].translation - whole.poses[TURN // 2].translation)
    units = 2 * WALK_RADIUS_M / across
    scaled = {row: Pose(pose.rotation, units * pose.translation) for row, pose in whole.poses.items()}
    assert end_error_m(scaled) < 0.05


def test_down_reaches_the_adjustment_in_the_frame_of_the_path(
    wall: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    asked: list[tuple[float, float, float] | None] = []

    def recorded(*given: Any, **options: Any) -> Reconstruction | None:
        asked.append(options["down"])
        return rejoined(*given, **options)

    def down_of(part: Reconstruction) -> DownDirection:
        x, y, z = (part.poses[0].rotation @ true_pose(0).rotation.T @ [0.0, 0.0, -1.0]).tolist()
        return DownDirection((x, y, z), "sensor", {})

    monkeypatch.setattr(path_of_sequence, "rejoined", recorded)
    found = reconstruct_sequence(
        sequence(wall, copies=False),
        CAMERA,
        range(FRAMES),
        down_of,
        is_calibrated=True,
        scratch=None,
        progress=NoProgress(),
    )
    assert asked
    np.testing.assert_allclose(asked[-1], down_of(found.parts[0]).down, atol=0.02)


def test_a_path_is_settled_where_the_same_pictures_hardly_moved(
    structure: tuple[Reconstruction, MatchedPictures],
) -> None:
    part, _ = structure
    turn = drifted_pose(40)
    moved = {row: turn @ Pose(pose.rotation, 3 * pose.translation) for row, pose in part.poses.items()}
    same = replace(part, poses=moved, points=turn.apply(3 * part.points))
    assert path_of_sequence._is_settled(part, same)
    assert not path_of_sequence._is_settled(None, part)
    fewer = {row: pose for row, pose in moved.items() if row}
    assert not path_of_sequence._is_settled(part, replace(same, poses=fewer))
    true = {row: true_pose(row) for row in part.poses}
    assert not path_of_sequence._is_settled(part, replace(part, poses=true))


def test_a_path_that_is_bent_after_all_is_cut(wall: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    short = replace(windows.OPTIONS, pictures=24, stride=14, calibrated_on=30)
    monkeypatch.setattr(windows, "OPTIONS", short)
    bend = 33

    def bent(*given: Any, **options: Any) -> Reconstruction:
        part = rejoined(*given, **options)
        assert part is not None
        hinge = part.poses[bend].translation
        poses = {
            row: Pose(pose.rotation, hinge + (1.3 if row > bend else 1.0) * (pose.translation - hinge))
            for row, pose in part.poses.items()
        }
        return replace(part, poses=poses)

    monkeypatch.setattr(path_of_sequence, "rejoined", bent)
    matched = sequence(wall, copies=False)
    near = {pair: rows for pair, rows in matched.matches.items() if pair[1] - pair[0] <= 3}
    found = reconstruct_sequence(
        MatchedPictures(matched.features, near),
        CAMERA,
        range(FRAMES),
        lambda part: None,
        is_calibrated=True,
        scratch=None,
        progress=NoProgress(),
    )
    assert len(found.parts[0].poses) > 20
    assert not any(min(part.poses) <= bend < max(part.poses) for part in found.parts)


def test_poses_that_are_nearly_right_are_adjusted_and_the_next_pictures_registered(wall: Array) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    matched = sequence(wall, copies=False)
    few = MatchedPictures(
        matched.features, {pair: rows for pair, rows in matched.matches.items() if max(pair) < 13}
    )
    start = {frame: drifted_pose(frame) for frame in range(10)}
    part = rejoined(few, start, CAMERA, is_calibrated=True, scratch=None, progress=NoProgress())
    assert part is not None
    assert sorted(part.poses) == list(range(13))
    assert part.error_px < 0.6
    steps = [np.linalg.norm(part.poses[k].translation - part.poses[k + 1].translation) for k in range(12)]
    assert np.std(steps) / np.mean(steps) < 0.03


def first_twelve(wall: Array) -> tuple[MatchedPictures, dict[int, Pose]]:
    matched = sequence(wall, copies=False)
    matches = {pair: rows for pair, rows in matched.matches.items() if max(pair) < 12}
    return MatchedPictures(matched.features, matches), {frame: drifted_pose(frame) for frame in range(12)}


class Counting:
    """Counts reports of the adjustment; raises at one of them."""

    def __init__(self, raises_at: int | None = None) -> None:
        self.raises_at = raises_at
        self.count = 0

    def report(self, stage: str, done: int, total: int) -> None:
        self.count += stage == joined.STAGE and done == total
        if self.count == self.raises_at:
            raise CancelledBuildError("stopped")


def test_an_adjustment_reports_while_it_runs(wall: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    few, start = first_twelve(wall)
    counts = []
    for every_s in (100.0, 0.001):
        monkeypatch.setattr(joined, "OPTIONS", replace(joined.OPTIONS, report_every_s=every_s))
        progress = Counting()
        assert rejoined(few, start, CAMERA, is_calibrated=True, scratch=None, progress=progress) is not None
        counts.append(progress.count)
    assert counts[0] == 1 + joined.OPTIONS.rounds
    assert counts[1] > counts[0]


def test_an_adjustment_that_is_cancelled_ends(wall: Array) -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    few, start = first_twelve(wall)
    progress = Counting(raises_at=2)
    with pytest.raises(CancelledBuildError):
        rejoined(few, start, CAMERA, is_calibrated=True, scratch=None, progress=progress)
    assert progress.count == 2
