from itertools import pairwise

import numpy as np
import pytest

from app.geometry.se3 import Pose, attitude_difference_rad
from bench.recordings.queries import room_of
from bench.recordings.scan import VENUE_FRAMES, WING_FRAMES
from bench.recordings.trajectory import VENUE_WALK, WING_WALK, query_poses, scan_poses
from bench.venue.layout import FLOOR_HEIGHT_M, ROOMS, WING_ROOMS, room_by_id
from bench.venue.walkable import clearance_m, ground_z_m, sees


@pytest.fixture(scope="module")
def wing() -> list[Pose]:
    return scan_poses(WING_WALK, WING_FRAMES)


@pytest.fixture(scope="module")
def venue() -> list[Pose]:
    return scan_poses(VENUE_WALK, VENUE_FRAMES)


def on_stair(pose: Pose) -> bool:
    x0, y0, x1, y1 = room_by_id("stair").interior
    return x0 < pose.translation[0] < x1 and y0 < pose.translation[1] < y1


def check_clear(poses: list[Pose]) -> None:
    for pose, following in pairwise(poses):
        if on_stair(pose) or on_stair(following):
            continue
        floor = int(pose.translation[2] > FLOOR_HEIGHT_M)
        assert clearance_m(pose.translation[None, :2], floor)[0] > 0.15
        assert sees(pose.translation[:2], following.translation[:2], floor)


def test_the_wing_scan_never_meets_walls_or_furniture(wing):
    check_clear(wing)


def test_the_venue_scan_never_meets_walls_or_furniture(venue):
    check_clear(venue)


def test_the_scanner_is_carried_at_chest_height(venue):
    for pose in venue:
        x, y, z = pose.translation
        heights = [z - ground_z_m(x, y, floor) for floor in (0, 1)]
        assert min(abs(h - 1.45) for h in heights) < 0.3
        assert abs(np.degrees(np.arcsin(pose.rotation[2, 2]))) < 30


def test_neighbouring_frames_overlap(wing):
    for a, b in pairwise(wing):
        assert np.linalg.norm(a.translation - b.translation) < 0.8
        assert np.degrees(attitude_difference_rad(a, b)) < 30


def test_each_room_of_the_wing_is_seen_in_many_directions(wing):
    for room in WING_ROOMS:
        forward = np.array([p.rotation[:, 2] for p in wing if room_of(p).id == room])
        sectors = {int(angle // (np.pi / 4)) for angle in np.arctan2(forward[:, 1], forward[:, 0])}
        assert len(sectors) >= 7, room


def test_the_venue_scan_visits_every_room_but_the_lifts(venue):
    visited = {room_of(pose).id for pose in venue}
    assert {room.id for room in ROOMS if not room.id.endswith("lift")} <= visited


def test_scan_poses_are_deterministic(wing):
    again = scan_poses(WING_WALK, WING_FRAMES)
    assert all(np.array_equal(a.matrix, b.matrix) for a, b in zip(wing, again, strict=True))


def test_queries_are_near_the_scan_but_not_on_it(wing):
    queries = query_poses(wing, 50)
    nearest = []
    for query in queries:
        assert clearance_m(query.translation[None, :2], 0)[0] >= 0.3
        assert 1.3 <= query.translation[2] <= 1.7
        offsets = [np.linalg.norm((p.translation - query.translation)[:2]) for p in wing]
        turns = [np.degrees(attitude_difference_rad(p, query)) for p in wing]
        assert any(o <= 0.65 and t <= 50 for o, t in zip(offsets, turns, strict=True))
        nearest.append(min(offsets))
    assert np.median(nearest) > 0.1
