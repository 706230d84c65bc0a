"""A scan that passes its places twice: drift of its poses is found and taken back, right poses stay as they are."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.inspection.loops import OPTIONS, sampled_loops
from app.engine.mapping.loops import close
from app.engine.mapping.loops.close import OPTIONS as CLOSURE
from app.engine.mapping.loops.close import bend_m, close_loops, held_back, spread_over
from app.engine.mapping.loops.optimize import Loop, loop_errors_m, optimized
from app.engine.mapping.loops.places import choose_places, ways_m
from app.engine.progress import NoProgress
from app.geometry.alignment import align_points
from app.geometry.camera_hint import parse_camera_hint
from app.geometry.se3 import Pose, position_difference_m
from app.importers.frames import Scan, ScanOptions
from app.importers.registry import open_scan
from tests.drifting import around, drifted
from tests.rendered_maps import models
from tests.scenes import CAMERA_TEXT, DEPTH_SCALE, Room, pose_at, scan_files

ROUNDS = 2
A_ROUND = 16


def error_m(path: Sequence[Pose], true: Sequence[Pose]) -> float:
    return align_points([p.translation for p in path], [p.translation for p in true]).residual_rms_m


def poses_of(scan: Scan) -> list[Pose]:
    return [frame.scan_from_camera for frame in scan.frames]


def with_poses(scan: Scan, poses: Sequence[Pose]) -> Scan:
    frames = (replace(f, scan_from_camera=pose) for f, pose in zip(scan.frames, poses, strict=True))
    return replace(scan, frames=tuple(frames))


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory, room: Room) -> Scan:
    root = tmp_path_factory.mktemp("around")
    views = [room.view(pose) for pose in around(ROUNDS, ROUNDS * A_ROUND)]
    for name, data in scan_files(views).items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    given = ScanOptions(camera=parse_camera_hint(CAMERA_TEXT, "camera"), depth_scale=DEPTH_SCALE)
    return open_scan(root, "tum", given)


def test_drift_is_taken_back_and_right_poses_stay(scan: Scan) -> None:
    true = poses_of(scan)
    path = drifted(true, 0.03, 0.004)
    with ThreadPoolExecutor(1) as executor:
        right = close_loops(scan, models(), executor, NoProgress())
        mended = close_loops(with_poses(scan, path), models(), executor, NoProgress())
    assert right.scan is scan
    assert (right.is_applied, right.warnings) == (False, ())
    assert right.before_m is not None
    assert right.before_m < 0.02
    assert mended.is_applied
    assert mended.before_m is not None
    assert mended.after_m is not None
    assert mended.after_m < 0.2 * mended.before_m
    assert error_m(path, true) > 0.03
    assert error_m(poses_of(mended.scan), true) < 0.5 * error_m(path, true)
    assert "drift" in mended.warnings[0]
    assert mended.as_dict()["applied"] is True


def test_a_scan_without_depth_or_that_passes_no_place_twice_is_not_looked_at(scan: Scan) -> None:
    straight = [pose_at(0.1 * k, 1.0, 1.4, 0.0) for k in range(len(scan.frames))]
    with ThreadPoolExecutor(1) as executor:
        for each in (replace(scan, has_depth=False), with_poses(scan, straight)):
            found = close_loops(each, models(), executor, NoProgress())
            assert (found.scan is each, found.compared, found.is_applied) == (True, 0, False)


def test_a_few_pairs_tell_a_path_that_drifts_from_one_that_does_not(scan: Scan) -> None:
    true = poses_of(scan)
    straight = [pose_at(0.1 * k, 1.0, 1.4, 0.0) for k in range(len(true))]
    with ThreadPoolExecutor(1) as executor:
        right, wrong, once = (
            sampled_loops(each, executor, NoProgress())
            for each in (
                scan,
                with_poses(scan, drifted(true, 0.03, 0.004)),
                with_poses(scan, straight),
            )
        )
        assert sampled_loops(replace(scan, has_depth=False), executor, NoProgress()) is None
    assert right is not None
    assert wrong is not None
    assert 3 <= right.found <= right.compared <= OPTIONS.max_pairs
    assert right.error_m is not None
    assert wrong.error_m is not None
    assert right.error_m < 0.02
    assert wrong.error_m > 3 * right.error_m
    assert once is not None
    assert once.as_dict() == {"compared": 0, "found": 0, "error_m": None}


def test_pictures_that_cannot_be_decoded_close_no_loop(scan: Scan, tmp_path: Path) -> None:
    junk = tmp_path / "junk.png"
    junk.write_bytes(b"no picture")
    damaged = replace(scan, frames=tuple(replace(frame, color=junk) for frame in scan.frames))
    with ThreadPoolExecutor(1) as executor:
        found = sampled_loops(damaged, executor, NoProgress())
    assert found is not None
    assert (found.compared > 0, found.found, found.error_m) == (True, 0, None)


# Walked twice, so that each place of the second round closes a loop with the first.
LONG = [
    pose_at(8 * np.cos(a), 8 * np.sin(a), 1.4, np.degrees(a) + 90) for a in np.linspace(0, 4 * np.pi, 160)
]


def loops_of(path: Sequence[Pose], every: int = 4) -> list[Loop]:
    half = len(path) // 2
    pairs = [(k, k + half) for k in range(0, half, every)]
    return [Loop(a, b, path[a].inverse() @ path[b]) for a, b in pairs]


def test_wrong_loops_among_right_ones_change_little() -> None:
    path = drifted(LONG, 0.01, 0.0005)
    wrong = [Loop(k, k + 70, Pose.identity()) for k in range(5, 80, 20)]
    found = optimized(path, [*loops_of(LONG), *wrong])
    assert error_m(path, LONG) > 0.2
    assert error_m(found, LONG) < 0.4 * error_m(path, LONG)
    assert float(np.median(loop_errors_m(found, loops_of(LONG)))) < 0.01
    assert position_difference_m(found[0], path[0]) < 1e-6


def lifted(pose: Pose, height_m: float) -> Pose:
    return Pose(pose.rotation, pose.translation + np.array([0.0, 0.0, height_m]))


def test_a_path_that_would_be_bent_stays_as_it_is(scan: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    given = with_poses(scan, drifted(poses_of(scan), 0.03, 0.004))
    monkeypatch.setattr(close, "bend_m", lambda *_: CLOSURE.max_error_m + 0.01)
    with ThreadPoolExecutor(1) as executor:
        found = close_loops(given, models(), executor, NoProgress())
    assert found.scan is given
    assert (found.is_fold, found.is_applied, found.moved_m) == (True, False, 0.0)
    assert "look alike" in found.warnings[0]
    assert found.as_dict()["fold"] is True


def test_a_correction_that_lays_a_floor_over_another_is_no_drift() -> None:
    # A round on one floor, a short stair, and a round on the next one, which looks the same.
    half = len(LONG) // 2
    up = np.concatenate([np.zeros(half - 5), np.linspace(0, 3.5, 10), np.full(half - 5, 3.5)])
    path = [lifted(p, z) for p, z in zip(LONG, up, strict=True)]
    alike = optimized(path, loops_of(LONG))
    assert float(np.median(loop_errors_m(alike, loops_of(LONG)))) < 0.3
    assert bend_m(path, alike, ways_m(path)) > 1.0
    slowly = drifted(LONG, 0.02, 0.0005)
    assert bend_m(slowly, optimized(slowly, loops_of(LONG)), ways_m(slowly)) < CLOSURE.max_error_m


def test_loops_between_the_same_stretches_are_held_back_together() -> None:
    loops = loops_of(LONG, every=1)
    used, held = held_back(loops)
    assert sorted(loop.a for loop in (*used, *held)) == [loop.a for loop in loops]
    assert not {(loop.a // 3, loop.b // 3) for loop in used} & {(loop.a // 3, loop.b // 3) for loop in held}
    assert held_back(loops[:12]) == ([], [])


def test_frames_between_two_places_move_as_both() -> None:
    way = ways_m(LONG)
    rows = choose_places(way)[::3]
    rows = rows if rows[-1] == len(LONG) - 1 else [*rows, len(LONG) - 1]
    moved = [
        Pose(LONG[row].rotation, LONG[row].translation + np.array([0.0, 0.0, 0.01 * row])) for row in rows
    ]
    found = spread_over(LONG, way, rows, moved)
    lifted = [pose.translation[2] - 1.4 for pose in found]
    assert lifted == pytest.approx([0.01 * k for k in range(len(LONG))], abs=1e-6)
