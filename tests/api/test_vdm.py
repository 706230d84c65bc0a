"""The Visual-Depth Map over HTTP: its keyframe rules, maps by uniform motion, and /locate by its method."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from tests.api.test_locate import pose_errors
from tests.scenes import CAMERA_TEXT, Room, View, encode, pose_at, scan_files, zipped
from tests.server import Server, assert_problem, assert_sentence

MOTION = {"start": [1.0, 1.4, 1.4], "speed_m_s": 0.6, "direction_deg": 20.0, "fps": 10.0}


def without_poses(views: list[View]) -> bytes:
    return zipped({name: data for name, data in scan_files(views).items() if name != "groundtruth.txt"})


def straight_walk(room: Room, frames: int = 14, first: float = 0.0) -> list[View]:
    angle = np.radians(20.0)
    steps = [0.06 * (first + i) for i in range(frames)]
    poses = [pose_at(1.0 + s * np.cos(angle), 1.4 + s * np.sin(angle), 1.4, 20.0) for s in steps]
    return [room.view(pose) for pose in poses]


def test_a_photo_gets_its_pose_by_lines(museum: Server, queries: list[View]) -> None:
    for query in queries:
        result = museum.locate(query.jpeg(), venue="museum", method="vdm")
        assert result["located"] is True
        assert result["method"] == "vdm"
        error_m, error_deg = pose_errors(result, query.world_from_camera)
        assert error_m < 0.05
        assert error_deg < 1.0
        assert error_m < 5 * result["accuracy"]["position_m"]
        assert 0.5 < result["confidence"] <= 1
        assert 1 <= len(result["keyframes"]) <= 4
        assert set(result["timings_ms"]) == {"decode", "describe", "retrieve", "match", "pose", "total"}


def test_without_a_camera_the_focal_length_is_found(museum: Server, room: Room) -> None:
    query = room.view(pose_at(1.7, 1.4, 1.45, 28.0, 2.0))
    result = museum.post_image(query.jpeg(), {"venue": "museum", "method": "vdm"}).json()
    assert result["located"], result["reason"]
    assert result["camera"]["source"] == "search"
    assert pose_errors(result, query.world_from_camera)[0] < 0.2


def test_what_is_not_in_the_map_is_not_located(
    museum: Server, foreign_room: Room, queries: list[View]
) -> None:
    images = [foreign_room.view(query.world_from_camera).jpeg() for query in queries]
    images.append(encode(cv2.flip(queries[0].rgb[..., ::-1], 1), ".png"))
    images.append(encode(np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8), ".png"))
    for image in images:
        result = museum.locate(image, venue="museum", method="vdm")
        assert result["located"] is False
        assert result["reason"] in ("no_match", "too_few_inliers", "ambiguous")
        assert result["pose"] is None
    blank = encode(np.full((240, 320, 3), 128, np.uint8), ".png")
    assert museum.locate(blank, venue="museum", method="vdm")["reason"] == "poor_image"


def test_a_room_that_is_there_twice_is_ambiguous(
    museum: Server, views: list[View], queries: list[View]
) -> None:
    scan = zipped(scan_files(views[:8]))
    venue = museum.add_venue("vdm-twins")
    moved = np.eye(4)
    moved[0, 3] = 30.0
    again = {"mode": "extend", "world_from_scan": moved.tolist(), "force": True}
    museum.add_maps(venue, (scan, {"gravity": [0, 0, -1]}), (scan, again))
    for query in queries[:2]:
        result = museum.locate(query.jpeg(), venue=venue, method="vdm")
        assert (result["located"], result["reason"]) == (False, "ambiguous")
    x, y, z = (float(value) for value in queries[0].world_from_camera.translation)
    prior = json.dumps({"position": {"x": x + 30, "y": y, "z": z}, "radius_m": 5})
    result = museum.locate(queries[0].jpeg(), venue=venue, prior=prior, method="vdm")
    assert result["pose"]["position"]["x"] == pytest.approx(x + 30, abs=0.05)


def test_a_venue_without_a_map_says_so(empty: Server, queries: list[View]) -> None:
    empty.add_venue("bare")
    result = empty.locate(queries[0].jpeg(), method="vdm")
    assert (result["method"], result["reason"]) == ("vdm", "no_map")
    answer = empty.post_image(queries[0].jpeg(), {"method": "epipolar"})
    assert_problem(answer, 422)


@pytest.mark.parametrize(
    "rule",
    [
        {"rule": "content", "alpha": 0.35, "beta": 0.2, "combine": "and"},
        {"rule": "content", "alpha": 0.4, "beta": 0.3, "combine": "or"},
        {"rule": "distance", "every_m": 0.15},
        {"rule": "interval", "every": 3},
    ],
    ids=json.dumps,
)
def test_every_rule_makes_a_map_that_locates(
    museum: Server, scan_zip: bytes, queries: list[View], rule: dict[str, object]
) -> None:
    venue = museum.add_venue("by-" + "-".join(str(v).replace(".", "") for v in rule.values()))
    build = museum.build(scan_zip, venue, keyframes=rule)
    assert build["state"] == "succeeded", build["error"]
    assert 2 <= build["report"]["keyframes"] < 14
    located = [museum.locate(query.jpeg(), venue=venue) for query in queries]
    assert sum(result["located"] for result in located) >= 3
    for result, query in zip(located, queries, strict=True):
        if result["located"]:
            assert pose_errors(result, query.world_from_camera)[0] < 0.05


def test_a_walk_without_poses_becomes_a_map_by_uniform_motion(museum: Server, room: Room) -> None:
    venue = museum.add_venue("walked")
    build = museum.build(without_poses(straight_walk(room)), venue, **MOTION)
    assert build["state"] == "succeeded", build["error"]
    assert build["report"]["placement"]["source"] == "gravity"
    for query in straight_walk(room, frames=3, first=3.5):
        result = museum.locate(query.jpeg(), venue=venue)
        assert pose_errors(result, query.world_from_camera)[0] < 0.05


def test_without_poses_or_motion_and_with_both_a_build_fails_clearly(museum: Server, room: Room) -> None:
    venue = museum.add_venue("unposed")
    views = straight_walk(room, 6)
    missing = museum.build(without_poses(views), venue)
    both = museum.build(zipped(scan_files(views)), venue, **MOTION)
    assert (missing["state"], both["state"]) == ("failed", "failed")
    assert "groundtruth.txt is missing" in missing["error"]
    assert "speed_m_s" in missing["error"]
    assert "poses of its own" in both["error"]
    for build in (missing, both):
        assert_sentence(build["error"])


@pytest.mark.parametrize(
    "options",
    [
        {"keyframes": {"rule": "content", "alpha": 2}},
        {"keyframes": {"rule": "distance", "every_m": -1}},
        {"max_features_per_keyframe": 3},
        {"start": [0, 0, 0]},
        {**MOTION, "fps": 0},
    ],
    ids=json.dumps,
)
def test_options_that_cannot_be_meant_are_refused(
    museum: Server, scan_zip: bytes, options: dict[str, object]
) -> None:
    with museum.unchanged():
        answer = museum.client.post(
            "/database/build",
            data={"venue": "museum", "options": json.dumps({"camera": CAMERA_TEXT, **options})},
            files={"archive": ("scan.zip", scan_zip, "application/zip")},
        )
        assert_problem(answer, 422, "invalid_input")
