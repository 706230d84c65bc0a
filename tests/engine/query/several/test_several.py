"""Several frames in one query: what they add to each other, and what they may not lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.localization import Localization
from app.engine.query.localizer import Localizer
from app.engine.query.placed import Accuracy
from app.engine.query.query import Query
from app.engine.query.settings import LocalizerSettings
from app.engine.query.several.frame import GivenFrame, ask_alone
from app.engine.query.several.localize import localize_several
from app.engine.query.several.with_motion import agree, locate_with_motion
from app.engine.query.several.without_motion import locate_without_motion
from app.errors import InvalidInputError
from app.geometry.se3 import Pose, position_difference_m, rotation_angle_deg, rotation_from_vector
from app.geometry.turns import camera_from_turned, turned_camera
from app.vision.images import Rgb
from tests.rendered_maps import localizer_of
from tests.scenes import CAMERA, Room, View, pose_at

QUERY = pose_at(1.9, 1.5, 1.43, 5.0, 1.0)
NEXT = pose_at(1.97, 1.52, 1.42, 3.0, 0.5)
LAST = pose_at(2.02, 1.53, 1.43, 1.0, 0.0)
KEYFRAMES = [
    pose_at(2.0, 1.55, 1.4, 1.0),
    pose_at(1.8, 1.5, 1.4, 9.0),
    pose_at(1.9, 1.6, 1.4, 5.0),
]
APART_M = 8.0


@pytest.fixture(scope="module")
def wall(room: Room) -> Localizer:
    """A map of one wall of the room."""
    return quick(localizer_of([room.view(pose) for pose in KEYFRAMES]))


def quick(localizer: Localizer) -> Localizer:
    """Return the localizer without the later attempts, which find nothing in these pictures either."""
    return Localizer(localizer.map, LocalizerSettings(second_attempt=0, second_look=False))


def part_of(rgb: Rgb, first: int, last: int) -> Rgb:
    """Return a picture that shows only its columns `first` to `last`."""
    out = np.full_like(rgb, 128)
    out[:, first:last] = rgb[:, first:last]
    return out


def frame(rgb: Rgb, pose: Pose | None = None) -> GivenFrame:
    """Return a frame, with its true motion if its pose is given."""
    return GivenFrame(
        rgb=rgb, camera=CAMERA, first_from_camera=None if pose is None else QUERY.inverse() @ pose
    )


def assert_at_query(found: Localization) -> None:
    assert found.world_from_camera is not None, found.reason
    assert position_difference_m(found.world_from_camera, QUERY) < 0.03


def assert_refused(found: Localization, *reasons: str) -> None:
    assert found.world_from_camera is None
    assert found.accuracy is None
    assert found.reason in reasons


def test_frames_that_say_too_little_alone_are_enough_together(wall: Localizer, room: Room) -> None:
    first, second = part_of(room.view(QUERY).rgb, 0, 30), part_of(room.view(NEXT).rgb, 290, 320)
    assert_refused(wall.localize(first, CAMERA), "too_few_inliers", "no_match")
    assert_refused(wall.localize(second, CAMERA), "too_few_inliers", "no_match")
    found = localize_several(wall, [frame(first, QUERY), frame(second, NEXT)])
    assert_at_query(found)
    assert [support.inliers > 0 for support in found.frames] == [True, True]
    assert found.evidence.inliers <= sum(support.inliers for support in found.frames)


def test_the_same_picture_again_is_no_more_evidence(wall: Localizer, room: Room) -> None:
    weak = part_of(room.view(QUERY).rgb, 0, 30)
    once = localize_several(wall, [frame(weak, QUERY), frame(np.full_like(weak, 128), QUERY)])
    again = localize_several(wall, [frame(weak, QUERY)] * 6)
    assert_refused(again, "too_few_inliers")
    assert again.evidence.inliers <= 1.2 * once.evidence.inliers
    assert again.evidence.coverage <= 1.2 * once.evidence.coverage


def test_a_motion_that_two_frames_contradict_is_refused(wall: Localizer, room: Room) -> None:
    frames = [frame(room.view(QUERY).rgb, QUERY), frame(room.view(NEXT).rgb, NEXT)]
    assert_at_query(localize_several(wall, frames))
    false = Pose(NEXT.rotation, NEXT.translation + np.array([0.5, 0.0, 0.0]))
    assert_refused(localize_several(wall, [frames[0], frame(room.view(NEXT).rgb, false)]), "ambiguous")


def test_one_frame_that_two_others_contradict_is_left_out(wall: Localizer, room: Room) -> None:
    false = Pose(LAST.rotation, LAST.translation + np.array([0.5, 0.0, 0.0]))
    right = [frame(room.view(QUERY).rgb, QUERY), frame(room.view(NEXT).rgb, NEXT)]
    found = localize_several(wall, [*right, frame(room.view(LAST).rgb, false)])
    assert_at_query(found)
    assert [support.inliers > 0 for support in found.frames] == [True, True, False]


def test_frame_0_is_not_answered_against_its_own_pose(wall: Localizer, room: Room) -> None:
    moved = Pose(np.eye(3), np.array([0.5, 0.0, 0.0]))
    given = [frame(room.view(pose).rgb, moved @ pose) for pose in (NEXT, LAST)]
    asked = [ask_alone(wall, each) for each in (frame(room.view(QUERY).rgb, QUERY), *given)]
    assert all(each.world_from_first is not None for each in asked)
    assert_refused(locate_with_motion(wall, asked), "ambiguous")


def test_a_frame_whose_camera_was_refined_contradicts_another_only_beyond_its_own_accuracy(
    wall: Localizer, room: Room
) -> None:
    given = [frame(room.view(QUERY).rgb, QUERY), frame(room.view(NEXT).rgb, NEXT)]
    first, second = (ask_alone(wall, each) for each in given)
    aside = Pose(NEXT.rotation, NEXT.translation + np.array([0.2, 0.0, 0.0]))
    moved = replace(second.found, world_from_camera=aside)
    assert_refused(locate_with_motion(wall, [first, replace(second, found=moved)]), "ambiguous")
    refined = replace(moved, camera_trust="refined", accuracy=Accuracy(0.1, 2.0))
    assert_at_query(locate_with_motion(wall, [first, replace(second, found=refined)]))
    surer = replace(refined, accuracy=Accuracy(0.02, 2.0))
    assert_refused(locate_with_motion(wall, [first, replace(second, found=surer)]), "ambiguous")


def test_one_other_frame_alone_does_not_answer_for_frame_0(wall: Localizer, room: Room) -> None:
    blank = np.full_like(room.view(QUERY).rgb, 128)
    other, third = frame(room.view(NEXT).rgb, NEXT), frame(room.view(LAST).rgb, LAST)
    assert_refused(localize_several(wall, [frame(blank, QUERY), other]), "too_few_inliers")
    # Two others that agree confirm the motion.
    found = localize_several(wall, [frame(blank, QUERY), other, third])
    assert_at_query(found)
    assert found.frames[0].inliers == 0


def test_another_place_that_explains_a_part_is_a_rival_in_bursts_too(room: Room, foreign_room: Room) -> None:
    def mapped(view: View, first: int, last: int, moved_m: float) -> View:
        depth_m = np.zeros_like(view.depth_m)
        depth_m[:, first:last] = view.depth_m[:, first:last]
        pose = view.world_from_camera
        return View(Pose(pose.rotation, pose.translation + np.array([moved_m, 0, 0])), view.rgb, depth_m)

    both = quick(
        localizer_of(
            [
                *(mapped(room.view(pose), 0, 180, 0.0) for pose in KEYFRAMES),
                *(mapped(foreign_room.view(pose), 200, CAMERA.width, APART_M) for pose in KEYFRAMES),
            ]
        )
    )
    frames = []
    for pose in (QUERY, NEXT):
        picture = room.view(pose).rgb.copy()
        picture[:, 190:] = foreign_room.view(pose).rgb[:, 190:]
        frames.append(frame(picture, pose))
    assert_refused(localize_several(both, frames), "ambiguous")
    assert_refused(
        localize_several(both, [replace(each, first_from_camera=None) for each in frames]), "ambiguous"
    )


def test_frames_turned_by_gravity_are_answered_as_they_were_given(wall: Localizer, room: Room) -> None:
    turned_from_upright = camera_from_turned(1).inverse()
    given = [
        GivenFrame(
            rgb=np.ascontiguousarray(np.rot90(room.view(pose).rgb)),
            camera=turned_camera(CAMERA, 1),
            first_from_camera=turned_from_upright @ QUERY.inverse() @ pose @ turned_from_upright.inverse(),
            gravity=(1.0, 0.0, 0.0),
        )
        for pose in (QUERY, NEXT)
    ]
    found = localize_several(wall, given)
    assert_at_query(found)
    assert found.world_from_camera is not None
    truth = QUERY @ turned_from_upright.inverse()
    assert rotation_angle_deg(found.world_from_camera.rotation.T @ truth.rotation) < 0.5
    assert found.camera is not None
    assert (found.camera.width, found.camera.height) == (CAMERA.height, CAMERA.width)
    # Matches to draw are those of the turned picture.
    assert found.inliers is None


def test_without_motion_what_a_located_frame_shows_is_carried_over_to_frame_0(
    wall: Localizer, room: Room
) -> None:
    first, second = ask_alone(wall, frame(room.view(QUERY).rgb)), ask_alone(wall, frame(room.view(NEXT).rgb))
    whole = locate_without_motion(wall, [first, second])
    assert_at_query(whole)
    assert whole.frames[0].inliers > 100
    # Of frame 0 no match with the map is known, only those with frame 1.
    unmatched = replace(
        first,
        found=first.found.refused("no_match"),
        matcher=wall.matcher_of(Query.of(room.view(QUERY).rgb, CAMERA)),
    )
    carried = locate_without_motion(wall, [unmatched, second])
    assert_at_query(carried)
    assert carried.confidence <= second.found.confidence
    lost = replace(second, found=second.found.refused("no_match"))
    assert_refused(locate_without_motion(wall, [unmatched, lost]), "no_match")


def test_without_motion_a_frame_that_shows_too_little_stays_unplaced(wall: Localizer, room: Room) -> None:
    weak = part_of(room.view(QUERY).rgb, 0, 30)
    assert_refused(localize_several(wall, [frame(weak), frame(room.view(NEXT).rgb)]), "too_few_inliers")


def test_without_motion_places_that_are_apart_are_ambiguous(room: Room, foreign_room: Room) -> None:
    def moved(view: View) -> View:
        pose = view.world_from_camera
        return View(
            Pose(pose.rotation, pose.translation + np.array([APART_M, 0.0, 0.0])), view.rgb, view.depth_m
        )

    both = quick(
        localizer_of(
            [
                *(room.view(pose) for pose in KEYFRAMES),
                *(moved(foreign_room.view(pose)) for pose in KEYFRAMES),
            ]
        )
    )
    here, there = frame(room.view(QUERY).rgb), frame(foreign_room.view(QUERY).rgb)
    assert_at_query(localize_several(both, [here, frame(room.view(NEXT).rgb)]))
    assert_refused(localize_several(both, [here, there]), "ambiguous")
    # Two against one: what is alone is left out, unless it is frame 0, whose pose is asked for.
    found = localize_several(both, [here, there, frame(room.view(NEXT).rgb)])
    assert_at_query(found)
    assert found.frames[1].inliers == 0
    assert_refused(localize_several(both, [there, here, frame(room.view(NEXT).rgb)]), "ambiguous")


def test_a_motion_needs_cameras(wall: Localizer, room: Room) -> None:
    picture = room.view(QUERY).rgb
    with pytest.raises(InvalidInputError, match="send camera"):
        localize_several(wall, [frame(picture, QUERY), replace(frame(picture, NEXT), camera=None)])


def test_poses_may_differ_by_what_their_inliers_leave_open() -> None:
    straight = pose_at(2.0, 1.5)
    turned = Pose(rotation_from_vector(np.radians([0.0, 0.0, 8.0])) @ straight.rotation, straight.translation)
    assert not agree(straight, turned, 0.01)
    assert agree(straight, turned, 0.1)
    aside = pose_at(2.3, 1.5)
    assert not agree(straight, aside, 0.05)
    assert agree(straight, aside, 0.1)
