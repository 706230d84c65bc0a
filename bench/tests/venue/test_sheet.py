"""A marker's sheet lies in a rendered picture where its pose says, behind what is nearer."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from app.engine.mapping.structure.markers import DICTIONARY
from app.geometry.se3 import Pose
from bench.recordings.floor_video import FLOORS, FRAMES, MARKER_SIDE_M, FilmedFloor, marker_sheet, video_poses
from bench.recordings.scan import SCAN_CAMERA as CAMERA
from bench.render.sheet import with_sheet
from bench.venue.walkable import clearance_m

SHAPE = (CAMERA.height, CAMERA.width)
GREY = np.full((*SHAPE, 3), 90, np.uint8)
FAR = np.full(SHAPE, 9.0, np.float32)


@pytest.fixture(scope="module", params=sorted(FLOORS))
def filmed(request: pytest.FixtureRequest) -> FilmedFloor:
    return FLOORS[str(request.param)]


@pytest.fixture(scope="module")
def poses(filmed: FilmedFloor) -> list[Pose]:
    return video_poses(filmed)


@pytest.mark.parametrize("number", [2, 10, 20])
def test_the_marker_is_seen_where_it_hangs(filmed: FilmedFloor, poses: list[Pose], number: int) -> None:
    sheet, pose = marker_sheet(filmed), poses[number]
    picture = with_sheet(GREY, FAR, CAMERA, pose, sheet)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARY))
    found, numbers, _ = detector.detectMarkers(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    assert numbers is not None
    assert numbers.ravel().tolist() == [sheet.number]
    half = MARKER_SIDE_M / 2
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    true = CAMERA.project((pose.inverse() @ sheet.world_from_sheet).apply(corners))
    assert np.abs(found[0][0] - true).max() < 1.0


def test_what_is_nearer_hides_it_and_its_back_shows_nothing(filmed: FilmedFloor, poses: list[Pose]) -> None:
    near = np.full(SHAPE, 0.5, np.float32)
    assert (with_sheet(GREY, near, CAMERA, poses[10], marker_sheet(filmed)) == GREY).all()
    behind = Pose(poses[10].rotation, np.array(filmed.marker_at) - np.array([2.0, 0.0, 0.0]))
    assert (with_sheet(GREY, FAR, CAMERA, behind, marker_sheet(filmed)) == GREY).all()


def test_the_walk_is_free_and_steady(filmed: FilmedFloor, poses: list[Pose]) -> None:
    places = np.array([pose.translation for pose in poses])
    assert len(poses) == FRAMES
    assert clearance_m(places[:, :2], filmed.floor).min() > 0.05
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.3
    assert np.linalg.norm(places[0, :2] - filmed.marker_at[:2]) < 2.0
    assert np.linalg.norm(places[-1] - places[0]) < 2.0
