"""Tracking where a single picture says nothing: two rooms that look the same, told apart by where the camera was."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.engine.mapping.build_map import build_map
from app.engine.mapping.options import parse_build_options
from app.engine.maps.vision_models import VisionModels
from app.engine.progress import NoProgress
from app.engine.query.localizer import Localizer
from app.engine.query.placed import Accuracy, PlacedPose
from app.engine.tracking.fix import OPTIONS, Fix, MapFixes, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.state import TrackingMemory
from app.geometry.se3 import Pose
from app.importers.registry import open_scan
from tests.scenes import CAMERA, CAMERA_TEXT, Room, View, pose_at, scan_files
from tests.tracking import TrackerIn, pose_of

# The other room is so far along x.
APART_M = 5.0


def moved(pose: Pose, by_m: float) -> Pose:
    return Pose(pose.rotation, pose.translation + np.array([by_m, 0.0, 0.0]))


@pytest.fixture(scope="module")
def twins(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> MapFixes:
    """Fixes by the map of a room and of another one that looks the same."""
    folder = tmp_path_factory.mktemp("twins")
    others = [View(moved(view.world_from_camera, APART_M), view.rgb, view.depth_m) for view in views]
    for name, data in scan_files([*views, *others]).items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    options = parse_build_options({"camera": CAMERA_TEXT, "world_from_scan": np.eye(4).tolist()})
    models = VisionModels()
    with ThreadPoolExecutor(2) as executor:
        built = build_map(
            open_scan(Path(folder), "tum", options.scan), options, models, executor, NoProgress()
        )
    return MapFixes(Localizer.of(built.artifact, built.index, models))


@pytest.fixture(scope="module")
def view(room: Room) -> View:
    return room.view(pose_at(1.75, 1.4, 1.43, 5.0, 1.0))


def test_a_picture_alone_is_refused(twins: MapFixes, view: View) -> None:
    found = twins.locate(TrackingFrame.of(view.rgb, 0.0), CAMERA, None)
    assert isinstance(found, NoFix)
    assert found.reason == "ambiguous"


@pytest.mark.parametrize("by_m", [0.0, APART_M])
def test_where_the_camera_was_tells_which_room_it_is_in(twins: MapFixes, view: View, by_m: float) -> None:
    last = moved(pose_at(1.6, 1.3, 1.43, -50.0), by_m)
    found = twins.nearby(TrackingFrame.of(view.rgb, 0.0), CAMERA, last, 1.5)
    assert isinstance(found, Fix)
    truth = moved(view.world_from_camera, by_m)
    assert np.linalg.norm(found.frame_from_camera.translation - truth.translation) < 0.03


def test_a_camera_that_may_be_in_either_room_is_in_none(twins: MapFixes, view: View) -> None:
    between = moved(view.world_from_camera, APART_M / 2)
    frame = TrackingFrame.of(view.rgb, 0.0)
    assert twins.nearby(frame, CAMERA, between, APART_M / 2 + 0.3) is None
    assert twins.nearby(frame, CAMERA, between, APART_M / 2 - 0.3) is None


def test_a_session_that_lost_sight_of_a_room_finds_itself_in_it_again(twins: MapFixes, view: View) -> None:
    last = moved(pose_at(1.6, 1.3, 1.43, -50.0), APART_M)
    memory = TrackingMemory(
        state="tracking", last=PlacedPose(last), time_s=10.0, fix_accuracy=Accuracy(0.02, 0.0)
    )
    tracked = TrackerIn(twins, memory).process(TrackingFrame.of(view.rgb, 10.5), CAMERA)
    assert tracked.state == "tracking"
    assert pose_of(tracked) is not None
    truth = moved(view.world_from_camera, APART_M)
    assert np.linalg.norm(pose_of(tracked).translation - truth.translation) < 0.03


def test_a_place_that_much_of_the_picture_speaks_against_is_none(
    twins: MapFixes, view: View, monkeypatch: pytest.MonkeyPatch
) -> None:
    # In the right half of the picture hangs something else than in the map.
    altered = view.rgb.copy()
    half = altered.shape[1] // 2
    altered[:, half:] = np.rot90(altered[:, half:], 2)
    frame = TrackingFrame.of(altered, 0.0)
    assert twins.refresh(frame, CAMERA, view.world_from_camera) is None
    lenient = replace(OPTIONS, max_contradicted_share=1.0)
    monkeypatch.setattr("app.engine.tracking.fix.OPTIONS", lenient)
    assert twins.refresh(frame, CAMERA, view.world_from_camera) is not None
    assert twins.refresh(TrackingFrame.of(view.rgb, 0.0), CAMERA, view.world_from_camera) is not None


def test_the_last_place_tells_rooms_apart_unless_the_floor_can_have_been_left(
    twins: MapFixes, view: View
) -> None:
    # The other room is out of the prior's reach from here.
    last = moved(view.world_from_camera, -3.0)
    memory = TrackingMemory(
        state="lost", last=PlacedPose(last), time_s=10.0, fix_accuracy=Accuracy(0.02, 0.0)
    )
    frame = TrackingFrame.of(view.rgb, 20.0)
    stayed = TrackerIn(twins, memory)
    assert pose_of(stayed.process(frame, CAMERA)) is not None
    gone = TrackerIn(twins, memory, can_change_floor=lambda _, away_s: away_s >= 10.0)
    found = gone.process(frame, CAMERA)
    assert (found.state, found.reason) == ("lost", "ambiguous")
