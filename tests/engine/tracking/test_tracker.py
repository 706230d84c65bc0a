"""Tracking in a rendered room: by a map, by odometry alone, and from another camera's view."""

from __future__ import annotations

import json
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
from app.engine.query.placed import Accuracy, PlacedPose, Support
from app.engine.tracking.fix import Fix, MapFixes, NoFix
from app.engine.tracking.frame import TrackingFrame
from app.engine.tracking.memory import memory_from_json, memory_to_json
from app.engine.tracking.settings import TrackerSettings
from app.engine.tracking.tracked import Tracked
from app.engine.tracking.two_view_fix import (
    KnownView,
    TrackedPlace,
    at_common_scale,
    fix_from_two_views,
    metric_relative_pose,
)
from app.geometry.camera import Camera
from app.geometry.epipolar import estimate_relative_pose
from app.geometry.lens import LENS_SIGMA, Lens
from app.geometry.se3 import Pose, rotation_from_vector
from app.geometry.triangulation import metric_scale, pixel_depths
from app.importers.registry import open_scan
from app.vision.images import Rgb, to_gray
from app.vision.local_features import RootSift
from app.vision.matching import match_unit_vectors, to_unit_vectors
from tests.scenes import CAMERA, CAMERA_TEXT, Room, View, pose_at, scan_files
from tests.tracking import TrackerIn, pose_of, sigma_m

FPS = 10.0
ODOMETRY_ONLY = TrackerSettings(use_refresh=False, relocalize_every=10**6)


@pytest.fixture(scope="module")
def fixes(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> MapFixes:
    """Fixes by the map of the synthetic scan."""
    folder = tmp_path_factory.mktemp("scan")
    for name, data in scan_files(views).items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    options = parse_build_options({"camera": CAMERA_TEXT, "world_from_scan": np.eye(4).tolist()})
    models = VisionModels()
    scan = open_scan(Path(folder), "tum", options.scan)
    with ThreadPoolExecutor(2) as executor:
        built = build_map(scan, options, models, executor, NoProgress())
    return MapFixes(Localizer.of(built.artifact, built.index, models))


def walk(count: int, step_m: float = 0.03, turn_deg: float = 1.2) -> list[Pose]:
    """Return the way of a phone through the room."""
    return [
        pose_at(1.5 + step_m * i, 1.35 + 0.4 * step_m * i, 1.45, -25 + turn_deg * i, 1.0)
        for i in range(count)
    ]


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What the phone sees on its way."""
    return [room.view(pose) for pose in walk(30)]


def frame_of(view: View | Rgb, number: int) -> TrackingFrame:
    return TrackingFrame.of(view.rgb if isinstance(view, View) else view, number / FPS)


def run(tracker: TrackerIn, views: list[View], first: int = 0) -> list[Tracked]:
    return [tracker.process(frame_of(view, first + i), CAMERA) for i, view in enumerate(views)]


def error_m(tracked: Tracked, truth: Pose) -> float:
    assert pose_of(tracked) is not None, tracked.reason
    return float(np.linalg.norm(pose_of(tracked).translation - truth.translation))


def test_a_video_is_tracked_by_the_map(fixes: MapFixes, video: list[View]) -> None:
    results = run(TrackerIn(fixes), video)
    assert {result.state for result in results} == {"tracking"}
    assert {"rgbd", "odometry"} == {result.method for result in results}
    for result, view in zip(results, video, strict=True):
        error = error_m(result, view.world_from_camera)
        assert error < 0.02
        assert result.accuracy is not None
        assert error < 5 * sigma_m(result) + 0.005


def test_a_first_fix_that_gravity_contradicts_is_none(fixes: MapFixes, video: list[View]) -> None:
    upright = TrackingFrame.of(video[0].rgb, 0.0, (0.0, 1.0, 0.0), CAMERA)
    lying = TrackingFrame.of(video[0].rgb, 0.0, (0.9, 0.4, 0.0), CAMERA)
    assert isinstance(fixes.locate(upright, CAMERA, None), Fix)
    refused = fixes.locate(lying, CAMERA, None)
    assert isinstance(refused, NoFix)
    assert refused.reason == "ambiguous"


def test_odometry_goes_on_without_a_map_and_says_how_far_off_it_may_be(
    fixes: MapFixes, video: list[View]
) -> None:
    tracker = TrackerIn(fixes, settings=ODOMETRY_ONLY)
    results = run(tracker, video)
    assert all(result.state == "tracking" for result in results)
    # A walk straight on explains nearly any lens: alone it shows none.
    assert tracker.memory.lens == (0.0, LENS_SIGMA)
    path_m = 29 * 0.03 * float(np.hypot(1.0, 0.4))
    assert error_m(results[-1], video[-1].world_from_camera) < 0.04 * path_m
    sigmas = [sigma_m(result) for result in results]
    unaided = [result.unaided_m for result in results]
    assert unaided == sorted(unaided)
    # Jitter counts as path, too.
    assert 0.9 * path_m < unaided[-1] < 1.3 * path_m
    # The first one is what the picture leaves open of its camera.
    assert sigmas[-1] > max(0.03 * path_m, sigmas[0])


class AnotherView(MapFixes):
    """Fixes by a monitoring camera: the relative pose of two views, made metric by one known distance."""

    def __init__(self, anchor: View, scale_sigma: float = 0.01) -> None:
        self.known = KnownView(CAMERA, PlacedPose(anchor.world_from_camera), scale_sigma)
        self._anchor = anchor
        self._extractor = RootSift(max_side_px=960)

    def locate(
        self, frame: TrackingFrame, camera: Camera | None, near: Pose | None, any_floor: bool = False
    ) -> Fix | NoFix:
        assert camera is not None
        ours, theirs = self._extractor.extract(frame.gray), self._extractor.extract(to_gray(self._anchor.rgb))
        a, b, _ = match_unit_vectors(
            to_unit_vectors(ours.descriptors, False), to_unit_vectors(theirs.descriptors, False), 0.85
        )
        phone_px, anchor_px = ours.keypoints_px[a].astype(float), theirs.keypoints_px[b].astype(float)
        found = estimate_relative_pose(phone_px, anchor_px, camera, CAMERA)
        if found is None:
            return NoFix("no_match")
        phone_px, anchor_px = phone_px[found.inlier_mask], anchor_px[found.inlier_mask]
        # The known distance: how far the match nearest to the middle truly is from the monitoring camera.
        poi = int(np.argmin(np.linalg.norm(anchor_px - [160, 120], axis=1)))
        u, v = np.rint(anchor_px[poi]).astype(int)
        ray = CAMERA.unproject(anchor_px[poi : poi + 1], np.array([self._anchor.depth_m[v, u]]))[0]
        normalized = CAMERA.normalize(anchor_px[poi : poi + 1])[0]

        _, s2 = pixel_depths(
            camera.normalize(phone_px[poi : poi + 1]),
            CAMERA.normalize(anchor_px[poi : poi + 1]),
            found.b_from_a,
        )
        scale = metric_scale(float(np.linalg.norm(ray)), float(s2[0]), normalized)
        anchor_from_phone = metric_relative_pose(found.b_from_a, scale)
        fix = fix_from_two_views(phone_px, anchor_px, camera, self.known, anchor_from_phone)
        return NoFix("too_few_inliers") if fix is None else fix

    def refresh(self, frame: TrackingFrame, camera: Camera, predicted: Pose) -> Fix | None:
        return None

    def nearby(self, frame: TrackingFrame, camera: Camera, near: Pose, reach_m: float) -> Fix | None:
        return None


def test_odometry_starts_with_the_scale_of_an_anchor(room: Room, video: list[View]) -> None:
    anchor = room.view(pose_at(1.0, 1.7, 1.9, -35, -8))
    results = run(TrackerIn(AnotherView(anchor), settings=ODOMETRY_ONLY), video)
    assert all(result.state == "tracking" for result in results)
    assert results[0].method == "anchor"
    truth = [view.world_from_camera.translation for view in video]
    found = [pose_of(result).translation for result in results if pose_of(result)]
    known_m = float(np.linalg.norm(truth[-1] - truth[0]))
    tracked_m = float(np.linalg.norm(found[-1] - found[0]))
    assert tracked_m == pytest.approx(known_m, rel=0.05)
    for result, view in zip(results, video, strict=True):
        assert error_m(result, view.world_from_camera) < 3 * sigma_m(result)


def test_fixes_by_an_anchor_come_to_one_scale_and_contradicting_ones_to_none() -> None:
    empty = np.zeros((1, 2))
    fix = Fix(
        placed=PlacedPose(Pose(np.eye(3), np.array([1.1, 0.0, 0.0]))),
        accuracy=Accuracy(0.2, 1.0),
        support=Support(30, 40),
        confidence=0.9,
        points_px=empty,
        points_in_frame=np.zeros((1, 3)),
        point_sigma_m=np.ones(1),
        camera=CAMERA,
        scale_sigma=0.1,
        shared_scale_sigma=0.03,
    )
    place = TrackedPlace(PlacedPose(Pose(np.eye(3), np.array([0.9, 0.0, 0.0]))), Accuracy(0.2, 1.0), 0.1)
    found = at_common_scale(fix, place, 0.9)
    assert found is not None
    common, factor = found
    # Both are as certain: half of the way, for place and scale.
    assert common.frame_from_camera.translation[0] == pytest.approx(1.0)
    assert factor == pytest.approx(np.sqrt(1 / 0.9))
    assert 0.03 < common.scale_sigma < 0.1 / np.sqrt(2) + 0.01
    assert at_common_scale(fix, place, 0.5) is None
    sure = replace(place, accuracy=Accuracy(0.01, 1.0), scale_sigma=0.031)
    kept, factor = at_common_scale(fix, sure, 0.9) or (fix, 0.0)
    assert kept.frame_from_camera.translation[0] == pytest.approx(0.9, abs=0.01)
    assert factor == pytest.approx(1.0, abs=0.01)


def misled(source: AnotherView, video: list[View]) -> tuple[TrackerIn, list[Tracked]]:
    """Return a tracker whose lengths were 15 % too short after the first fix, and what it answers after that."""
    tracker = TrackerIn(source, settings=replace(ODOMETRY_ONLY, relocalize_every=4, use_relocation=True))
    results = run(tracker, video[:4])
    first = tracker.tracker._odometry
    assert first is not None
    first.rescale(0.85, pose_of(results[-1]) or Pose.identity())
    results = run(tracker, video[4:12], 4)
    assert tracker.tracker._odometry is first
    assert any(result.method == "anchor" for result in results)
    return tracker, results


def test_a_second_fix_by_an_anchor_tells_odometry_its_scale(room: Room, video: list[View]) -> None:
    anchor = room.view(pose_at(1.0, 1.7, 1.9, -35, -8))
    source = AnotherView(anchor)
    # The first fix takes the POI for nearer than it is, and says that it may.
    source.known = replace(source.known, scale_sigma=0.1)
    _, results = misled(source, video)
    assert all(result.state == "tracking" for result in results)
    assert error_m(results[-1], video[11].world_from_camera) < 0.1


def test_the_distances_that_an_anchor_knows_become_those_of_all_that_was_tracked(
    room: Room, video: list[View]
) -> None:
    anchor = room.view(pose_at(1.0, 1.7, 1.9, -35, -8))
    source = AnotherView(anchor)

    def scale_of(pixels: np.ndarray, lengths: np.ndarray) -> tuple[float, float]:
        u, v = np.rint(pixels).astype(int).T
        true_m = np.linalg.norm(CAMERA.unproject(pixels, anchor.depth_m[v, u].astype(float)), axis=1)
        return float(np.median(np.log(true_m / lengths))), 0.02

    source.known = replace(source.known, scale_sigma=0.1, scale_of=scale_of)
    tracker, results = misled(source, video)
    assert tracker.memory.fix_scale_sigma == pytest.approx(0.02)
    found = [pose_of(result).translation for result in results if pose_of(result)]
    truth = [view.world_from_camera.translation for view in video[4:12]]
    walked_m = float(np.linalg.norm(truth[-1] - truth[0]))
    assert float(np.linalg.norm(found[-1] - found[0])) == pytest.approx(walked_m, rel=0.08)
    assert error_m(results[-1], video[11].world_from_camera) < 0.04
    # Another camera's view is not this one's, and one that knows no distance changes none.
    fix = source.locate(frame_of(video[11], 11), CAMERA, None)
    assert isinstance(fix, Fix)
    first = tracker.tracker._odometry
    assert first is not None
    assert first.adjust_with(replace(fix, anchors=("another",)), 1.0) is None
    assert fix.seen is not None
    assert first.adjust_with(replace(fix, seen=replace(fix.seen, scale_of=None)), 1.0) is None


def test_a_session_learns_the_lens_of_a_camera_whose_distortion_is_not_stated(room: Room) -> None:
    lens = Lens(-0.1).of(CAMERA)
    mount = pose_at(1.0, 1.7, 1.9, -35, -8)
    anchor = room.view(mount)
    bent = [room.view(pose, lens) for pose in walk(40)]
    # A monitoring camera of the same make has the same lens.
    tracker = TrackerIn(AnotherView(room.view(mount, lens)), settings=ODOMETRY_ONLY)
    run(tracker, bent)
    coefficient, sigma = tracker.memory.lens
    assert -0.12 < coefficient < -0.02
    assert sigma < LENS_SIGMA
    # It outlives the process, and is not learned where it is stated.
    stored = json.loads(json.dumps(memory_to_json(tracker.memory)))
    assert Lens(*memory_from_json(stored).lens) == Lens(coefficient, sigma)
    straight = [room.view(pose) for pose in walk(40)]
    tracker = TrackerIn(AnotherView(anchor), settings=ODOMETRY_ONLY)
    run(tracker, straight)
    assert abs(tracker.memory.lens[0]) < 0.01
    stated = replace(CAMERA, model="OPENCV", params=(*CAMERA.params, 0.0, 0.0, 0.0, 0.0))
    tracker = TrackerIn(AnotherView(anchor), settings=ODOMETRY_ONLY)
    for i, view in enumerate(bent[:12]):
        tracker.process(frame_of(view, i), stated)
    assert tracker.memory.lens == (0.0, LENS_SIGMA)


def test_two_views_without_parallax_give_no_fix(video: list[View]) -> None:
    pixels = np.stack(np.meshgrid(np.linspace(20, 300, 10), np.linspace(20, 220, 8)), axis=-1).reshape(-1, 2)
    nearly = Pose(np.eye(3), np.array([1e-4, 0.0, 0.0]))
    assert (
        fix_from_two_views(pixels, pixels, CAMERA, KnownView(CAMERA, PlacedPose(Pose.identity())), nearly)
        is None
    )


def test_a_jump_within_a_frame_is_not_believed_until_it_is_seen_twice(
    fixes: MapFixes, room: Room, video: list[View]
) -> None:
    tracker = TrackerIn(fixes)
    run(tracker, video[:6])
    # Two metres in a tenth of a second.
    there = [room.view(pose_at(3.2 - 0.02 * i, 1.7, 1.45, 75.0)) for i in range(3)]
    results = run(tracker, there, 6)
    assert (results[0].state, pose_of(results[0]), results[0].reason) == ("lost", None, "ambiguous")
    assert [result.state for result in results[1:]] == ["relocalized", "tracking"]
    assert error_m(results[1], there[1].world_from_camera) < 0.05


def test_a_covered_view_is_lost_and_found_again(fixes: MapFixes, video: list[View]) -> None:
    tracker = TrackerIn(fixes)
    run(tracker, video[:5])
    hand = np.full_like(video[0].rgb, (200, 150, 130))
    noise = np.random.default_rng(1).normal(0, 6, hand.shape)
    covered = np.clip(hand + noise, 0, 255).astype(np.uint8)
    for i in range(5, 9):
        result = tracker.process(frame_of(covered, i), CAMERA)
        assert (result.state, pose_of(result)) == ("lost", None)
    results = run(tracker, video[9:12], 9)
    assert [result.state for result in results] == ["relocalized", "tracking", "tracking"]
    assert error_m(results[0], video[9].world_from_camera) < 0.03


def test_a_hand_that_moves_over_part_of_the_view_does_not_drag_the_pose(
    fixes: MapFixes, room: Room, foreign_room: Room, video: list[View]
) -> None:
    # What is printed on the hand moves the other way, and faster.
    over = [foreign_room.view(pose_at(2.0 - 0.05 * i, 1.4, 1.4, 20 - 3.0 * i)) for i in range(20)]
    tracker, located = TrackerIn(fixes, settings=ODOMETRY_ONLY), 0
    for i, view in enumerate(video[:20]):
        picture = view.rgb.copy()
        if i >= 3:
            picture[:, : 8 * min(i, 14)] = over[i].rgb[:, : 8 * min(i, 14)]
        result = tracker.process(frame_of(picture, i), CAMERA)
        located += pose_of(result) is not None
        if pose_of(result) is not None:
            assert error_m(result, view.world_from_camera) < 0.05
    assert located >= 5


def test_after_a_restart_the_next_frame_goes_on(fixes: MapFixes, video: list[View]) -> None:
    before = TrackerIn(fixes)
    run(before, video[:8])
    stored = json.loads(json.dumps(memory_to_json(before.memory)))
    after = TrackerIn(fixes, memory_from_json(stored))
    assert after.memory.state == "tracking"
    results = run(after, video[8:12], 8)
    assert [result.state for result in results] == ["tracking"] * 4
    assert error_m(results[0], video[8].world_from_camera) < 0.03


def test_the_phones_own_motion_is_used_and_checked(fixes: MapFixes, video: list[View]) -> None:
    poses = [view.world_from_camera for view in video]
    tracker = TrackerIn(fixes)
    for i in range(8):
        motion = poses[i - 1].inverse() @ poses[i] if i else None
        result = tracker.process(frame_of(video[i], i), CAMERA, motion)
        assert result.state == "tracking"
    # A phone that says it went a metre, while the picture hardly moved: one of both is wrong.
    wrong = Pose(rotation_from_vector([0, 0, 0]), np.array([1.0, 0.0, 0.0]))
    result = tracker.process(frame_of(video[8], 8), CAMERA, wrong)
    assert pose_of(result) is None or error_m(result, poses[8]) < 0.03


def test_a_camera_that_is_not_known_is_searched_for_once(fixes: MapFixes, room: Room) -> None:
    tracker = TrackerIn(fixes)
    corner = [room.view(pose_at(1.7 + 0.02 * i, 1.4, 1.45, 28.0, 2.0)) for i in range(3)]
    results = [tracker.process(frame_of(view, i), None) for i, view in enumerate(corner)]
    assert [result.state for result in results] == ["tracking"] * 3
    assert results[0].camera is not None
    assert results[2].camera == results[0].camera
    assert results[2].method == "odometry"


def test_outside_of_the_venue_nothing_is_believed(fixes: MapFixes, video: list[View]) -> None:
    tracker = TrackerIn(fixes, is_inside=lambda pose: bool(pose.translation[0] < 1.7))
    results = run(tracker, video[:12])
    assert results[0].state == "tracking"
    inside = [view.world_from_camera.translation[0] < 1.7 for view in video[:12]]
    for result, within in zip(results, inside, strict=True):
        if not within:
            assert (pose_of(result), result.reason) == (None, "outside_venue")


def test_no_map_is_a_reason(fixes: MapFixes, foreign_room: Room) -> None:
    tracker = TrackerIn(fixes)
    result = tracker.process(frame_of(foreign_room.view(pose_at(2.0, 1.5)), 0), CAMERA)
    assert (result.state, pose_of(result)) == ("initializing", None)
    assert result.reason in ("no_match", "too_few_inliers")
