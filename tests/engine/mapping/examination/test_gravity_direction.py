"""Gravity that the camera's turns, or the floor, contradict; right gravity however the camera was held."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.examination import gravity_direction
from app.engine.mapping.examination.examine import examine_scan
from app.engine.mapping.examination.gravity_direction import judge_gravity_direction
from app.engine.mapping.examination.outcome import Finding
from app.engine.mapping.options import parse_build_options
from app.engine.progress import NoProgress
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.conventions import PoseArrays
from app.importers.frames import Scan
from app.importers.registry import open_scan
from tests.engine.mapping.examination.scans import OPTIONS, write
from tests.scenes import Room, pose_at, scan_files

DOWN = (0.0, 0.0, -1.0)
ASIDE = [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]
LEANING = (float(np.sin(0.6)), 0.0, -float(np.cos(0.6)))


def scan_of(room: Room, poses: Sequence[Pose], folder: Path) -> Scan:
    options = parse_build_options(OPTIONS)
    return open_scan(write(scan_files([room.view(pose) for pose in poses]), folder), "tum", options.scan)


def judged(scan: Scan, gravity: tuple[float, float, float]) -> list[Finding]:
    poses = PoseArrays.of([frame.scan_from_camera for frame in scan.frames])
    return judge_gravity_direction(scan, scan.camera, poses, gravity)


@pytest.fixture(scope="module")
def round_the_room(room: Room, tmp_path_factory: pytest.TempPathFactory) -> Scan:
    poses = [pose_at(2.0, 1.5, yaw_deg=yaw, pitch_deg=-10) for yaw in range(0, 360, 60)]
    return scan_of(room, poses, tmp_path_factory.mktemp("round"))


@pytest.fixture(scope="module")
def one_way(room: Room, tmp_path_factory: pytest.TempPathFactory) -> Scan:
    poses = [pose_at(1.0 + 0.1 * i, 1.5, yaw_deg=3 * i, pitch_deg=-30) for i in range(8)]
    return scan_of(room, poses, tmp_path_factory.mktemp("one_way"))


@pytest.mark.parametrize("gravity", ASIDE)
def test_turns_of_the_camera_contradict_gravity(
    round_the_room: Scan, gravity: tuple[float, float, float]
) -> None:
    (found,) = judged(round_the_room, gravity)
    assert (found.code, found.severity, found.certain) == ("gravity_direction", "wrong", True)
    assert found.options["gravity"] == pytest.approx(DOWN, abs=1e-3)
    assert "90 degrees from the axis about which the camera turned" in found.sentence


def test_right_gravity_is_not_doubted(round_the_room: Scan, one_way: Scan) -> None:
    assert judged(round_the_room, DOWN) == judged(one_way, DOWN) == []
    without_length = (0.0, 0.0, -9.81)
    assert judged(one_way, without_length) == []


def test_a_camera_that_lies_on_its_side_is_not_doubted(round_the_room: Scan) -> None:
    quarter = rotation_from_vector(np.array([0.0, 0.0, np.pi / 2]))
    turned = [
        replace(frame, scan_from_camera=frame.scan_from_camera @ Pose(quarter, np.zeros(3)))
        for frame in round_the_room.frames
    ]
    assert judged(replace(round_the_room, frames=tuple(turned)), DOWN) == []


def test_a_wall_beside_a_camera_on_its_side_is_no_floor(
    room: Room, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_its_side = Pose(rotation_from_vector(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    poses = [pose_at(1.0 + 0.1 * i, 0.5, yaw_deg=40 + 3 * i, pitch_deg=-5) @ on_its_side for i in range(4)]
    scan = scan_of(room, poses, tmp_path)
    assert judged(scan, DOWN) == []
    # By its size alone it is one.
    upright = replace(gravity_direction.OPTIONS, sideways_rival_ratio=gravity_direction.OPTIONS.rival_ratio)
    monkeypatch.setattr(gravity_direction, "OPTIONS", upright)
    (found,) = judged(scan, DOWN)
    assert found.figures["floor_share"] > 0.2


@pytest.mark.parametrize("gravity", [(-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), LEANING])
def test_the_floor_contradicts_gravity(one_way: Scan, gravity: tuple[float, float, float]) -> None:
    (found,) = judged(one_way, gravity)
    assert (found.code, found.severity, found.certain) == ("gravity_direction", "doubtful", False)
    assert found.options["gravity"] == pytest.approx(DOWN, abs=0.02)
    assert found.figures["floor_share"] > 1.3 * found.figures["gravity_share"]


def test_the_examination_judges_the_direction_of_gravity(one_way: Scan) -> None:
    with ThreadPoolExecutor(1) as executor:
        found = examine_scan(one_way, parse_build_options(OPTIONS).scan, LEANING, executor, NoProgress())
    assert found.verdict == "doubtful"
    assert [finding.code for finding in found.findings] == ["gravity_direction"]
