"""The smaller services, each by what it promises."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from app.engine.floors.floor import Floor, PlanImage
from app.engine.floors.options import OPTIONS as FLOOR
from app.engine.floors.plan_point import floor_of, plan_point
from app.engine.mapping.extend_map import join_maps
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.mapping.register_scan import largest_agreement, spread
from app.engine.maps.points import OPTIONS, nearby_views
from app.engine.progress import NoProgress, map_in_order
from app.errors import CancelledBuildError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.frames import Frame
from app.vision.index import GlobalIndex
from tests.engine.maps.test_artifact import make_map
from tests.scenes import pose_at


class Recorder:
    """Notes what is reported; cancels at a number of steps."""

    def __init__(self, cancel_at: int | None = None) -> None:
        self.reports: list[tuple[str, int, int]] = []
        self._cancel_at = cancel_at

    def report(self, stage: str, done: int, total: int) -> None:
        self.reports.append((stage, done, total))
        if done == self._cancel_at:
            raise CancelledBuildError("cancelled")


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 100])
@pytest.mark.parametrize("window", [1, 4, 16])
def test_mapped_results_come_in_order_with_every_step_reported(count: int, window: int) -> None:
    recorder = Recorder()
    with ThreadPoolExecutor(3) as pool:
        results = list(map_in_order(pool, lambda i: i * i, range(count), "square", recorder, window))
    assert results == [i * i for i in range(count)]
    assert recorder.reports == [("square", done, count) for done in range(count + 1)]


def test_mapping_runs_no_further_ahead_than_its_window() -> None:
    started: list[int] = []
    with ThreadPoolExecutor(8) as pool:
        mapped = map_in_order(pool, started.append, range(50), "s", NoProgress(), window=5)
        next(mapped)
        assert len(started) <= 6
        mapped.close()
    assert len(started) <= 6


def test_a_failure_or_cancellation_ends_the_mapping() -> None:
    free, running = threading.Event(), threading.Event()

    def work(i: int) -> int:
        if i == 2:
            raise InvalidInputError("frame 2")
        return i

    with ThreadPoolExecutor(2) as pool:
        with pytest.raises(InvalidInputError, match="frame 2"):
            list(map_in_order(pool, work, range(40), "s", NoProgress()))
        recorder = Recorder(cancel_at=3)
        with pytest.raises(CancelledBuildError):
            list(map_in_order(pool, lambda i: i, range(40), "s", recorder))
        assert recorder.reports[-1] == ("s", 3, 40)
        pool.submit(lambda: (running.set(), free.wait()))
        running.wait()
        free.set()


def floor(
    name: str, z_min_m: float, z_max_m: float, matrix: object = None, plan: PlanImage | None = None
) -> Floor:
    plan_from_world = None if matrix is None else np.asarray(matrix, dtype=float)
    return Floor(
        venue_id="v",
        id=name,
        name=name,
        level=0,
        z_min_m=z_min_m,
        z_max_m=z_max_m,
        plan_from_world=plan_from_world,
        plan_residual_m=None,
        plan=plan,
        features_sha256=None,
    )


def test_a_camera_is_on_the_floor_that_holds_it_or_is_nearest() -> None:
    floors = [floor("0", 0, 2.5), floor("1", 3, 5.5)]

    def name_at(z: float) -> str | None:
        found = floor_of(floors, pose_at(0, 0, z))
        return None if found is None else found.id

    assert [name_at(z) for z in (0, 1.4, 2.5, 3, 4)] == ["0", "0", "0", "1", "1"]
    assert [name_at(z) for z in (2.7, 2.8)] == ["0", "1"]
    slack_m = FLOOR.height_slack_m
    assert [name_at(z) for z in (-slack_m + 0.01, -slack_m - 0.01)] == ["0", None]
    assert [name_at(z) for z in (5.79, 5.81, 50)] == ["1", None, None]
    assert floor_of([], pose_at(0, 0, 1)) is None


def test_a_pose_has_its_point_on_the_plan() -> None:
    quarter = [[0, -1, 0, 5], [1, 0, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]
    drawing = PlanImage(
        blob="b",
        media_type="image/png",
        width_px=400,
        height_px=300,
        meters_per_pixel=0.05,
        origin_px=(10.0, 200.0),
    )
    point = plan_point(floor("0", 0, 3, quarter, drawing), pose_at(1.0, 2.0, 1.4, 30.0))
    assert point is not None
    assert (point.x, point.y, point.heading_deg) == pytest.approx((3.0, 3.0, 120.0))
    assert (point.u_px, point.v_px) == pytest.approx((10 + 60, 200 - 60))
    bare = plan_point(floor("0", 0, 3, quarter), pose_at(1.0, 2.0))
    assert bare is not None
    assert (bare.u_px, bare.v_px) == (None, None)
    assert plan_point(floor("0", 0, 3), pose_at(1, 2)) is None


def test_the_largest_agreement_leaves_outliers_out() -> None:
    rng = np.random.default_rng(0)
    truth = Pose(rotation_from_vector([0.1, 0.2, 0.3]), [1, 2, 3])
    good = [
        Pose(
            rotation_from_vector(rng.normal(size=3) * 0.002) @ truth.rotation,
            truth.translation + rng.normal(size=3) * 0.01,
        )
        for _ in range(8)
    ]
    bad = [Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3) * 5) for _ in range(6)]
    turned = Pose(rotation_from_vector([0, 0, 0.2]) @ truth.rotation, truth.translation)
    mixed = [*bad[:3], *good[:4], turned, *bad[3:], *good[4:]]
    assert {id(pose) for pose in largest_agreement(mixed)} == {id(pose) for pose in good}
    assert largest_agreement([]) == []


def test_spread_takes_both_ends() -> None:
    frames = [Frame(str(i), float(i), None, None, Pose.identity()) for i in range(100)]  # type: ignore[arg-type]
    names = [int(frame.name) for frame in spread(frames, 12)]
    assert (names[0], names[-1], len(names)) == (0, 99, 12)
    assert set(np.diff(names)) <= {9}
    assert spread(frames[:5], 12) == frames[:5]


def test_nearby_views_see_the_same_from_elsewhere() -> None:
    here = pose_at(0, 0)
    assert nearby_views(here, [here, pose_at(0.3, 0), pose_at(5, 0), pose_at(0.3, 0, yaw_deg=90)]) == [1]
    crowd = [pose_at(0.01 * i, 0) for i in range(1, 100)]
    chosen = nearby_views(here, crowd)
    assert len(chosen) == OPTIONS.max_views
    assert (chosen[0], chosen[-1]) == (0, 98)


def test_joined_maps_hold_the_keyframes_of_both() -> None:
    a, b = make_map((5, 0, 7)), make_map((2, 4))
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(5, 8)).astype(np.float32)
    joined, index = join_maps(
        a, GlobalIndex.from_descriptors(rows[:3]), b, GlobalIndex.from_descriptors(rows[3:]), False
    )
    assert np.array_equal(index.descriptors, rows)
    assert (joined.keyframe_count, joined.feature_count) == (5, 18)
    for keyframe, (source, own) in enumerate([(a, 0), (a, 1), (a, 2), (b, 0), (b, 1)]):
        assert joined.camera(keyframe) == source.camera(own)
        assert np.array_equal(joined.pose(keyframe).matrix, source.pose(own).matrix)
        for name in ("keypoints_px", "points_in_world", "point_sigma_m", "descriptors"):
            mine = getattr(joined.arrays, name)[joined.rows(keyframe)]
            assert np.array_equal(mine, getattr(source.arrays, name)[source.rows(own)])
    assert joined.metadata.keyframe_names == a.metadata.keyframe_names + b.metadata.keyframe_names


def test_a_joined_map_keeps_what_each_knew_of_look_alikes() -> None:
    """Features without points are not stored: what resembles one of them is known to the map that it was built for."""
    a, b = make_map((5, 3)), make_map((2, 4))
    distance, keyframe = b.arrays.distance_elsewhere.copy(), b.arrays.keyframe_elsewhere.copy()
    distance[:], keyframe[:] = 0.0, -1
    keyframe[1] = 1
    b = replace(b, arrays=replace(b.arrays, distance_elsewhere=distance, keyframe_elsewhere=keyframe))
    index = GlobalIndex.from_descriptors(np.ones((2, 8), np.float32))
    joined = join_maps(a, index, b, index, False)[0].arrays
    # Keyframe 1 of the second map is the fourth one; a bound of no keyframe says nothing.
    assert (joined.distance_elsewhere[8 + 1], joined.keyframe_elsewhere[8 + 1]) == (0.0, 3)
    assert (joined.distance_elsewhere[8:] == 0.0).sum() == 1


@pytest.mark.parametrize("changes", [{"features": "sift"}, {"descriptor_sha256": "cd" * 32}], ids=str)
def test_maps_of_different_making_are_not_joined(changes: dict[str, str]) -> None:
    a = make_map((1,))
    other = replace(a, metadata=replace(a.metadata, **changes))
    index = GlobalIndex.from_descriptors(np.ones((1, 8), np.float32))
    with pytest.raises(InvalidInputError):
        join_maps(a, index, other, index, False)


def test_no_options_are_the_defaults() -> None:
    assert parse_build_options({}) == BuildOptions()
    options = parse_build_options(
        {
            "format": "7scenes",
            "camera": [1, 2, 3, 4],
            "gravity": [0, 0, -1],
            "keyframes": {"rule": "interval", "every": 3},
        }
    )
    assert (options.format, options.scan.camera, options.gravity) == (
        "7scenes",
        CameraHint(values=(1, 2, 3, 4)),
        (0, 0, -1),
    )
    assert (options.keyframes.rule, options.keyframes.every) == ("interval", 3)


def test_cameras_are_read_as_text_list_or_object() -> None:
    def camera_of(value: object) -> CameraHint | None:
        return parse_build_options({"camera": value}).scan.camera

    assert camera_of(None) is None
    assert camera_of("1, 2,3,4") == CameraHint(values=(1.0, 2.0, 3.0, 4.0))
    assert camera_of([500, 500, 320, 240, *[0] * 5]) == CameraHint(values=(500, 500, 320, 240, 0, 0, 0, 0, 0))
    assert camera_of({"width": 640, "height": 480, "params": [500, 500, 320, 240]}) == hint_of(
        Camera("PINHOLE", 640, 480, (500, 500, 320, 240))
    )
