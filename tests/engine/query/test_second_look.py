"""A frame in which the map's own features find too little is looked at again with XFeat and LighterGlue."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.mapping.build_map import BuiltMap, build_map
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.maps.open_map import OpenMap
from app.engine.maps.second_features import SecondFeatures
from app.engine.progress import NoProgress
from app.engine.query.attempt.second_look import is_hopeless, without_vague_directions
from app.engine.query.localizer import Localizer
from app.engine.query.placed import Accuracy
from app.engine.query.query import Query
from app.engine.query.second.agreement import Agreement, agreement_in_map
from app.engine.query.second.look import SecondMatcher, resembles_elsewhere
from app.engine.query.settings import LocalizerSettings
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.frames import ScanOptions
from app.importers.registry import open_scan
from app.vision.images import to_gray
from tests.rendered_maps import models
from tests.scenes import CAMERA, Room, pose_at, scan_files

SEEN_FROM = pose_at(1.5, 1.3, yaw_deg=4.0)


def built(folder: Path, room: Room, options: BuildOptions) -> BuiltMap:
    views = [room.view(pose_at(1.4 + 0.1 * i, 1.3, yaw_deg=-20 + 12 * i)) for i in range(5)]
    for path, data in scan_files(views).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    scan = open_scan(folder, "tum", ScanOptions(camera=hint_of(CAMERA)))
    with ThreadPoolExecutor(1) as executor:
        return build_map(scan, options, models(), executor, NoProgress())


@pytest.fixture(scope="module")
def opened(room: Room, tmp_path_factory: pytest.TempPathFactory) -> OpenMap:
    """A map whose own features recognise nothing."""
    made = built(tmp_path_factory.mktemp("scan"), room, parse_build_options({}))
    arrays = made.artifact.arrays
    other = np.random.default_rng(0).integers(0, 255, arrays.descriptors.shape).astype(np.uint8)
    artifact = replace(made.artifact, arrays=replace(arrays, descriptors=other))
    return OpenMap.of(artifact, made.index, models())


def test_what_the_first_look_misses_is_located(opened: OpenMap, room: Room) -> None:
    picture = room.view(SEEN_FROM).rgb
    once = Localizer(opened, LocalizerSettings(second_look=False)).localize(picture, CAMERA)
    assert once.world_from_camera is None
    found = Localizer(opened).localize(picture, CAMERA)
    assert found.world_from_camera is not None
    assert np.linalg.norm(found.world_from_camera.translation - SEEN_FROM.translation) < 0.05
    assert found.evidence.inliers > 60
    assert found.hints == ()


def test_a_vague_direction_is_refused(opened: OpenMap, room: Room) -> None:
    found = Localizer(opened).localize(room.view(SEEN_FROM).rgb, CAMERA)
    assert without_vague_directions(found) is found
    vague = without_vague_directions(replace(found, accuracy=Accuracy(0.01, 5.1)))
    assert (vague.world_from_camera, vague.reason) == (None, "too_few_inliers")
    assert without_vague_directions(vague) is vague


@pytest.mark.parametrize("number", range(3))
def test_a_right_pose_agrees_all_over_the_picture(opened: OpenMap, room: Room, number: int) -> None:
    pose = pose_at(1.45 + 0.1 * number, 1.3, yaw_deg=12.0 * number - 10)
    found = agreement(opened, room, pose, pose)
    assert found.agreeing >= 20
    assert found.disagreeing_share < 0.1
    assert found.balance == found.agreeing - found.disagreeing


@pytest.mark.parametrize(
    "claimed",
    [pose_at(1.5, 1.3, yaw_deg=24.0), pose_at(1.5, 1.9, yaw_deg=4.0), pose_at(1.5, 1.3, 2.0, yaw_deg=4.0)],
    ids=["turned", "beside", "above"],
)
def test_a_wrong_pose_disagrees(opened: OpenMap, room: Room, claimed: Pose) -> None:
    found = agreement(opened, room, SEEN_FROM, claimed)
    assert found.disagreeing_share > 0.4


def test_agreement_counts_the_keyframes_that_are_allowed(opened: OpenMap, room: Room) -> None:
    none = agreement(opened, room, SEEN_FROM, SEEN_FROM, allowed=np.zeros(0, np.int64))
    assert (none.agreeing, none.disagreeing, none.disagreeing_share) == (0, 0, 0.0)


def agreement(
    opened: OpenMap, room: Room, asked: Pose, claimed: Pose, allowed: NDArray[np.int64] | None = None
) -> Agreement:
    _, picture = models().xfeat.extract_dense(to_gray(room.view(asked).rgb))
    return agreement_in_map(opened, claimed, CAMERA, picture, allowed)


def test_a_feature_is_repeated_where_its_like_is_at_another_place(opened: OpenMap) -> None:
    unit = np.eye(64, dtype=np.float16)
    alike = np.zeros(64, np.float16)
    alike[[0, 1]] = 0.96, 0.28
    own = features_at([[0, 0, 0]] * 2, unit[:2])
    rows, flat = np.array([0, 1]), np.ones(3, np.float32)
    assert resembles_elsewhere(own, rows, features_at([[5, 0, 0]], alike[None]), flat).tolist() == [
        True,
        False,
    ]
    assert resembles_elsewhere(own, rows, features_at([[3, 0, 0]], alike[None]), flat).tolist() == [
        False,
        False,
    ]
    above, by_height = features_at([[0, 0, 3]], alike[None]), np.array([1, 1, 3], np.float32)
    assert resembles_elsewhere(own, rows, above, by_height).tolist() == [True, False]


def features_at(points: list[list[float]], descriptors: NDArray[np.float16]) -> SecondFeatures:
    count = len(points)
    return SecondFeatures(
        offsets=np.array([0, count]),
        keypoints_px=np.zeros((count, 2), np.float32),
        points_in_world=np.array(points, np.float32),
        point_sigma_m=np.zeros(count, np.float32),
        descriptors=descriptors,
    )


def test_another_room_is_not_located(opened: OpenMap, foreign_room: Room) -> None:
    for yaw_deg in (0.0, 90.0, 200.0):
        found = Localizer(opened).localize(foreign_room.view(pose_at(1.5, 1.3, yaw_deg=yaw_deg)).rgb, CAMERA)
        assert found.world_from_camera is None
        assert found.hints


@pytest.mark.parametrize(("is_right", "camera"), [(True, CAMERA), (False, CAMERA), (False, None)], ids=str)
def test_no_more_is_matched_where_the_first_pose_is_hopeless(
    opened: OpenMap, room: Room, is_right: bool, camera: Camera | None
) -> None:
    localizer, query = Localizer(opened), Query.of(room.view(SEEN_FROM).rgb, camera)
    assert opened.second_look is not None
    matcher = SecondMatcher(query, opened, localizer.matcher_of(query), opened.second_look)
    matches = matcher.match(range(5))
    if not is_right:
        shuffled = np.random.default_rng(0).permutation(matches.points_px)
        matches = replace(matches, points_px=shuffled)
    # Without a camera a pose is found only after a search for one.
    assert is_hopeless(localizer.search, matcher, matches) == (not is_right and camera is not None)


def test_a_map_without_second_features_has_no_second_look(opened: OpenMap, room: Room) -> None:
    bare = OpenMap.of(replace(opened.artifact, second=None), opened.index, models())
    assert bare.second_look is None
    assert Localizer(bare).localize(room.view(SEEN_FROM).rgb, CAMERA).world_from_camera is None


@pytest.mark.parametrize("options", [{"second_features": False}, {"store_images": False}], ids=str)
def test_a_build_without_them_or_without_pictures_keeps_none(
    options: dict[str, bool], room: Room, tmp_path: Path
) -> None:
    assert built(tmp_path, room, parse_build_options(options)).artifact.second is None


def test_a_build_keeps_the_best_of_each_keyframe(opened: OpenMap) -> None:
    second = opened.artifact.second
    assert second is not None
    assert len(second.offsets) == opened.artifact.keyframe_count + 1
    counts = np.diff(second.offsets)
    assert counts.min() > 50
    assert counts.max() <= 400
