"""Pictures that exactly one guard refuses: each test first shows that the same picture passes without the cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.geometry.se3 import Pose
from app.vision.images import Rgb
from tests.rendered_maps import localizer_of, map_of_views, models
from tests.scenes import CAMERA, Room, View, pose_at

WIDTH = CAMERA.width
QUERY = pose_at(1.9, 1.5, 1.43, 5.0, 1.0)
KEYFRAMES = [
    pose_at(2.0, 1.55, 1.4, 1.0),
    pose_at(1.8, 1.5, 1.4, 9.0),
    pose_at(1.9, 1.6, 1.4, 5.0),
]
# Two places this far apart along x share nothing.
APART_M = 8.0


def mapped_part(view: View, first: int, last: int, moved_m: float = 0.0) -> View:
    """Return a view of which the map holds the columns `first` to `last`, moved along x."""
    depth_m = np.zeros_like(view.depth_m)
    depth_m[:, first:last] = view.depth_m[:, first:last]
    pose = view.world_from_camera
    return View(Pose(pose.rotation, pose.translation + np.array([moved_m, 0.0, 0.0])), view.rgb, depth_m)


def error_m(found: Localization, truth: Pose = QUERY) -> float:
    assert found.world_from_camera is not None, found.reason
    return float(np.linalg.norm(found.world_from_camera.translation - truth.translation))


@pytest.fixture(scope="module")
def wall(room: Room) -> Localizer:
    """A map of one wall of the room."""
    return localizer_of([room.view(pose) for pose in KEYFRAMES])


def test_a_picture_that_two_places_explain_in_part_is_ambiguous(room: Room, foreign_room: Room) -> None:
    # Of one place the left part is mapped, of the other the right part, and nothing looks like anything elsewhere.
    left = [mapped_part(room.view(pose), 0, 180) for pose in KEYFRAMES]
    right = [mapped_part(foreign_room.view(pose), 200, WIDTH, APART_M) for pose in KEYFRAMES]
    both = localizer_of([*left, *right])
    picture = room.view(QUERY).rgb.copy()
    alone = both.localize(picture, CAMERA)
    assert error_m(alone) < 0.02
    picture[:, 190:] = foreign_room.view(QUERY).rgb[:, 190:]
    found = both.localize(picture, CAMERA)
    assert (found.world_from_camera, found.reason) == (None, "ambiguous")
    evidence = found.evidence
    # No other limit is near: the one place has more than half, distinct, and nothing in the picture contradicts it.
    assert evidence.inliers > 1.5 * evidence.rival > 1.5 * 100
    assert evidence.distinct_share > 0.95
    assert evidence.unrepeated is not None
    assert evidence.unrepeated > 1.5 * evidence.rival
    assert evidence.contradicted == 0.0
    # Without the other place in the map the same picture is located.
    assert error_m(localizer_of(left).localize(picture, CAMERA)) < 0.02
    # And so it is where the other place is not asked for.
    assert error_m(both.localize(picture, CAMERA, allowed=np.arange(len(left)))) < 0.02


def test_the_place_that_explains_more_is_the_answer_whichever_is_found_first(
    room: Room, foreign_room: Room
) -> None:
    # What shows the second place is just enough to be looked at, not enough to make the first one doubtful.
    left = [mapped_part(room.view(pose), 0, 220) for pose in KEYFRAMES]
    right = [mapped_part(foreign_room.view(pose), 240, WIDTH, APART_M) for pose in KEYFRAMES]
    picture = room.view(QUERY).rgb.copy()
    picture[:, 270:] = foreign_room.view(QUERY).rgb[:, 270:]
    found = localizer_of([*left, *right]).localize(picture, CAMERA)
    assert error_m(found) < 0.02
    assert 0 < found.evidence.rival < 0.45 * found.evidence.inliers


def seen_from_behind(keyframes: Sequence[Pose], wall_x_m: float) -> list[Pose]:
    """Return poses as far behind a wall across x as these are before it, facing it."""
    around = np.diag([-1.0, -1.0, 1.0])
    return [
        Pose(around @ pose.rotation, pose.translation * [-1.0, 1.0, 1.0] + [2 * wall_x_m, 0.0, 0.0])
        for pose in keyframes
    ]


def test_points_count_from_the_side_they_were_scanned_from_alone(room: Room, wall: Localizer) -> None:
    picture = room.view(QUERY).rgb
    assert error_m(wall.localize(picture, CAMERA)) < 0.02
    artifact, index = map_of_views([room.view(pose) for pose in KEYFRAMES])
    behind = seen_from_behind(KEYFRAMES, float(room.size_m[0]))
    arrays = replace(
        artifact.arrays,
        positions=np.stack([pose.translation for pose in behind]),
        quaternions=np.stack([pose.quaternion for pose in behind]),
    )
    found = Localizer.of(replace(artifact, arrays=arrays), index, models()).localize(picture, CAMERA)
    assert (found.world_from_camera, found.reason, found.evidence.inliers) == (None, "no_match", 0)
    assert found.evidence.matches > 100


def faint(picture: Rgb, contrast: float) -> Rgb:
    """Return a picture with so much of its contrast left."""
    return np.clip(np.rint(128 + contrast * (picture.astype(float) - 128)), 0, 255).astype(np.uint8)


def test_a_faint_picture_is_located_by_its_faint_features(room: Room) -> None:
    picture = faint(room.view(QUERY).rgb, 0.2)
    # These features, other than `sift`, are not searched again with a lower contrast threshold.
    full = localizer_of([room.view(pose) for pose in KEYFRAMES], "sift-full")
    once = Localizer(replace(full.map, faint_extractor=None))
    assert once.localize(picture, CAMERA).reason in ("no_match", "too_few_inliers")
    found = full.localize(picture, CAMERA)
    assert error_m(found) < 0.03
    assert found.evidence.inliers > 50


def test_a_picture_that_is_fainter_still_is_poor(room: Room, wall: Localizer) -> None:
    found = wall.localize(faint(room.view(QUERY).rgb, 0.04), CAMERA)
    assert (found.world_from_camera, found.reason) == (None, "poor_image")
