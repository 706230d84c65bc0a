"""Poses that agree with the pictures between neighbouring frames, and not as a whole; and cameras mounted askew."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.examination.evidence import FrameMatcher, gather_evidence
from app.engine.mapping.examination.time_offset import Track, offset_changes
from app.engine.mapping.options import parse_build_options
from app.engine.progress import NoProgress
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.conventions import PoseArrays, PoseConvention
from app.importers.registry import open_scan
from tests.engine.mapping.examination.scans import OPTIONS, examined, with_poses, write, written
from tests.scenes import Room, View, pose_at, scan_files

TURNED = rotation_from_vector(np.radians([0.0, 0.0, 20.0]))


def other_session(poses: list[Pose]) -> list[Pose]:
    """Return the poses with the last ones in another frame."""
    return [*poses[:6], *(Pose(TURNED, np.array([1.0, 0.3, 0.0])) @ pose for pose in poses[6:])]


def moved_aside(poses: list[Pose]) -> list[Pose]:
    return [*poses[:6], *(Pose(np.eye(3), np.array([0.3, 0.0, 0.0])) @ pose for pose in poses[6:])]


def test_a_trajectory_that_jumps_is_named(views: list[View], tmp_path: Path) -> None:
    found = examined(write(with_poses(views, other_session), tmp_path / "session"))
    assert [finding.code for finding in found.wrong] == ["poses_jump"]
    assert (found.remedy, "before the picture" in found.wrong[0].sentence) == (None, True)
    # Where a scan is not spoilt, it is warned of.
    found = examined(write(with_poses(views, moved_aside), tmp_path / "aside"))
    assert found.verdict == "doubtful"
    assert "poses_jump" in [finding.code for finding in found.findings]


def test_a_trajectory_that_drifts_is_named(room: Room, tmp_path: Path) -> None:
    there = [pose_at(2.0 + 0.1 * step, 2.0, yaw_deg=90) for step in range(8)]
    views = [room.view(pose) for pose in (*there, *there[::-1])]
    assert examined(write(scan_files(views), tmp_path / "right")).findings == ()

    def drifting(poses: list[Pose]) -> list[Pose]:
        return [
            Pose(pose.rotation, pose.translation + np.array([0.012 * row, 0.0, 0.0]))
            for row, pose in enumerate(poses)
        ]

    found = examined(write(with_poses(views, drifting), tmp_path / "wrong"))
    assert "poses_drift" in [finding.code for finding in found.findings]


def test_pictures_that_repeat_are_named(views: list[View], tmp_path: Path) -> None:
    twice = [
        View(view.world_from_camera, views[row - row % 2].rgb, views[row - row % 2].depth_m)
        for row, view in enumerate(views)
    ]
    assert examined(write(scan_files(twice), tmp_path)).verdict == "refused"


def test_positions_of_two_units_are_not_mended_by_one_factor(views: list[View], tmp_path: Path) -> None:
    def half(poses: list[Pose]) -> list[Pose]:
        return [*poses[:5], *(Pose(pose.rotation, 1000 * pose.translation) for pose in poses[5:])]

    found = examined(write(with_poses(views, half), tmp_path))
    assert (found.verdict, found.remedy) == ("refused", None)


def test_a_camera_at_an_angle_to_its_poses_is_named_and_mended(room: Room, tmp_path: Path) -> None:
    views = [
        room.view(pose_at(2.0 + 0.1 * step, 2.0, yaw_deg=60 + 7 * step, pitch_deg=-5 + 4 * (step % 4)))
        for step in range(10)
    ]
    mounted = PoseConvention(mount_deg=(4.0, -3.0, 3.0))
    found = examined(write(with_poses(views, written(mounted)), tmp_path))
    assert [finding.code for finding in found.wrong] == ["camera_mount"]
    assert found.remedy is not None
    assert found.remedy["mount_deg"] == pytest.approx(mounted.mount_deg, abs=0.5)
    assert examined(tmp_path, {**OPTIONS, **found.remedy}).verdict == "confirmed"


def test_clocks_that_do_not_run_alike_show_another_offset_later(room: Room, tmp_path: Path) -> None:
    def at(row: float) -> Pose:
        return pose_at(2.0 + 0.08 * row, 1.5, yaw_deg=40.0 + 0.6 * row**2, pitch_deg=-4.0)

    views = [room.view(at(row)) for row in range(12)]
    parsed = parse_build_options(dict(OPTIONS))
    scan = open_scan(write(scan_files(views), tmp_path), parsed.format, parsed.scan)
    with ThreadPoolExecutor(2) as executor:
        evidence = gather_evidence(FrameMatcher(scan), 12, executor, NoProgress())
    times_s = np.array([frame.timestamp_s for frame in scan.frames])
    rows_s = times_s[0] + 0.1 * np.arange(-4, 20)

    def changes(poses: list[Pose]) -> bool:
        track = Track.of_frames(rows_s, PoseArrays.of(poses), PoseConvention())
        return offset_changes(evidence, scan.camera, track, times_s)

    assert not changes([at(row - 1.0) for row in range(-4, 20)])
    assert changes([at(row - (0.0 if row < 6 else 2.0)) for row in range(-4, 20)])
