"""The video through a storey as a scan: frames are found by their numbers, and progress is passed on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import typer

from app.geometry.se3 import Pose, position_difference_m
from bench.recordings.floor_video import FPS, UPPER, FloorVideo, video_poses
from bench.recordings.queries import PHONE_CAMERA, DemoQuery
from bench.unposed.evaluate import true_pose_of
from bench.unposed.floor_video import WatchedProgress, evaluate_video, queries_of, scan_of


@dataclass
class Noted:
    reports: list[tuple[str, int, int]] = field(default_factory=list)

    def report(self, stage: str, done: int, total: int) -> None:
        self.reports.append((stage, done, total))


def test_frames_and_pictures_have_their_poses() -> None:
    poses = video_poses()[:20]
    query = DemoQuery(
        name="q",
        path=Path("q.jpg"),
        camera=PHONE_CAMERA,
        world_from_camera=Pose.identity(),
        room="1-lobby",
        floor=1,
    )
    files = tuple(Path(f"{k:06d}.jpg") for k in range(len(poses)))
    video = FloorVideo(files, tuple(poses), (query,))
    scan, queries = scan_of(video), queries_of(video)
    assert true_pose_of("video.mp4/000007", 0.0, scan) is poses[7]
    assert scan.frames[5].timestamp_s == 5 / FPS
    assert queries.scan.camera == PHONE_CAMERA
    assert [frame.scan_from_camera for frame in queries.frames] == [query.world_from_camera]
    assert not scan.has_depth
    scanned = scan_of(replace(video, depth=tuple(file.with_suffix(".png") for file in files)))
    assert (scanned.has_depth, scanned.frames[7].depth.name) == (True, "000007.png")


def test_another_building_is_filmed_on_the_same_walk_by_another_hand() -> None:
    other = UPPER.of_building(3)
    assert UPPER.of_building(0) is UPPER
    assert (other.name, other.stops, other.building.number) == ("upper of building 3", UPPER.stops, 3)
    apart = [position_difference_m(a, b) for a, b in zip(video_poses(), video_poses(other), strict=True)]
    assert 0.0 < max(apart) < 0.5


def test_reports_are_passed_on_and_the_longest_silence_has_its_stage() -> None:
    noted = Noted()
    watched = WatchedProgress(inner=noted)
    for done in range(3):
        watched.report("match_frames", done, 3)
    assert noted.reports == [("match_frames", done, 3) for done in range(3)]
    assert watched.longest_in in ("start", "match_frames")
    assert watched.longest_s > 0
    assert list(watched.stage_s) == ["start", "match_frames"]
    assert all(clock_s >= 0 and processor_s >= 0 for clock_s, processor_s in watched.stage_s.values())


def test_a_storey_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match="attic"):
        evaluate_video(folder=tmp_path / "video", floor="attic")
    assert not any(tmp_path.iterdir())
