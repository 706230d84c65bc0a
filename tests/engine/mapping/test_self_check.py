"""What the check of a finished map allows, by which keyframes a frame is located, and what is refused or warned of."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.examination.outcome import Examination, Verdict
from app.engine.mapping.options import parse_build_options
from app.engine.mapping.self_check import OPTIONS, allowed_errors, check_map, keyframes_not_beside
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.geometry.se3 import Pose
from app.importers.frames import Frame, Scan
from app.importers.registry import open_scan
from app.services.resources import open_models
from app.settings import Settings
from tests.engine.mapping.examination.scans import OPTIONS as SCAN_OPTIONS
from tests.engine.mapping.examination.scans import write
from tests.scenes import Room, View, pose_at, scan_files, walk


def examination(verdict: Verdict, usual_px: float = 2.0, depth_m: float = 2.0) -> Examination:
    return Examination(
        verdict=verdict, figures={"usual_error_px": usual_px, "usual_depth_m": depth_m}, findings=()
    )


def frame(number: int) -> Frame:
    return Frame(f"{number}.png", float(number), Path("a"), Path("b"), Pose.identity())


def test_the_frame_and_the_keyframes_beside_it_in_time_are_left_out() -> None:
    keyframes = [frame(number) for number in (0, 4, 8, 12, 16)]
    assert keyframes_not_beside(frame(8), keyframes).tolist() == [0, 4]
    assert keyframes_not_beside(frame(9), keyframes).tolist() == [0, 1, 4]
    assert keyframes_not_beside(frame(0), keyframes).tolist() == [2, 3, 4]


def test_more_is_allowed_where_the_scan_is_less_exact() -> None:
    unknown_m, unknown_deg = allowed_errors(None)
    assert (unknown_m, unknown_deg) == (OPTIONS.allowed_m, OPTIONS.allowed_deg)
    exact, rough = (allowed_errors(examination("confirmed", px)) for px in (1.0, 12.0))
    assert unknown_m < exact[0] < rough[0] < 0.3
    assert unknown_deg < exact[1] < rough[1] < OPTIONS.most_deg


@pytest.fixture(scope="module")
def models() -> VisionModels:
    return open_models(Settings(_env_file=None, open=True))


@pytest.fixture(scope="module")
def executor() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as workers:
        yield workers


@pytest.fixture(scope="module")
def scan(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Scan:
    folder = write(scan_files(views), tmp_path_factory.mktemp("scan"))
    return open_scan(folder, "tum", parse_build_options(dict(SCAN_OPTIONS)).scan)


@pytest.fixture(scope="module")
def built(scan: Scan, models: VisionModels, executor: Executor) -> BuiltMap:
    return build_map(scan, parse_build_options(dict(SCAN_OPTIONS)), models, executor, NoProgress())


def test_a_right_map_locates_its_frames(
    built: BuiltMap, scan: Scan, models: VisionModels, executor: Executor
) -> None:
    check = check_map(built, scan, models, executor, NoProgress(), examination("confirmed"))
    assert check.warnings == ()
    assert 0 < check.expected <= check.located
    assert check.median_position_m is not None
    assert check.median_position_m < 0.02


def moved(scan: Scan, change: Pose) -> Scan:
    frames = (replace(one, scan_from_camera=one.scan_from_camera @ change) for one in scan.frames)
    return replace(scan, frames=tuple(frames))


TURNED = pose_at(0, 0, 0, 0, 4).rotation @ pose_at(0, 0, 0).rotation.T


@pytest.mark.parametrize(
    "change", [Pose(np.eye(3), np.array([0.1, 0, 0])), Pose(TURNED, np.zeros(3))], ids=["0.1 m", "4 degrees"]
)
def test_frames_found_elsewhere_or_turned_refuse_a_map_and_warn_of_a_confirmed_one(
    built: BuiltMap, scan: Scan, models: VisionModels, executor: Executor, change: Pose
) -> None:
    elsewhere = moved(scan, change)
    with pytest.raises(InvalidScanError, match="degrees off"):
        check_map(built, elsewhere, models, executor, NoProgress(), examination("doubtful", 1.0, 1.0))
    check = check_map(built, elsewhere, models, executor, NoProgress(), examination("confirmed", 1.0, 1.0))
    assert len(check.warnings) == 1


def test_a_confirmed_scan_is_refused_where_frames_are_far_off(
    built: BuiltMap, scan: Scan, models: VisionModels, executor: Executor
) -> None:
    far = moved(scan, Pose(np.eye(3), np.array([0.5, 0, 0])))
    with pytest.raises(InvalidScanError, match=r"0\.50 m"):
        check_map(built, far, models, executor, NoProgress(), examination("confirmed"))


def test_too_few_located_frames_refuse_a_map_and_warn_of_a_confirmed_one(
    built: BuiltMap,
    scan: Scan,
    foreign_room: Room,
    models: VisionModels,
    executor: Executor,
    tmp_path: Path,
) -> None:
    views = [foreign_room.view(pose) for pose in walk(4)]
    folder = write(scan_files(views), tmp_path)
    strange = open_scan(folder, "tum", parse_build_options(dict(SCAN_OPTIONS)).scan)
    with pytest.raises(InvalidScanError, match="locates only 0 of"):
        check_map(built, strange, models, executor, NoProgress(), examination("unknown"))
    check = check_map(built, strange, models, executor, NoProgress(), examination("confirmed"))
    assert (check.located, check.median_position_m) == (0, None)
    assert "little texture" in check.warnings[0]
