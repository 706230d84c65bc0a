"""What matches alone show of a stated camera: each case is seen by one check only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from app.engine.query.hypothesis import Hypothesis
from app.engine.query.intrinsics import CheckedCamera, _starts, check_intrinsics, fitted_camera
from app.engine.query.intrinsics import _Refined as Refined
from app.engine.query.intrinsics import _with_spread as with_spread
from app.engine.query.intrinsics_options import OPTIONS
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy
from app.geometry.camera import Camera
from app.geometry.focal import pinhole
from app.geometry.intrinsics_check import square_pixels, zoomed_cameras
from app.geometry.pnp import PnpEstimate, estimate_poses_lo_ransac
from app.geometry.se3 import Pose, position_difference_m
from tests.scenes import CAMERA

LIMIT_PX = 4.0
HERE = Pose.identity()
rng = np.random.default_rng(8)


def points_seen(
    camera: Camera, count: int, depths_m: tuple[float, float], draw: np.random.Generator = rng
) -> tuple[NDArray, NDArray]:
    """Return pixels (n, 2) with half a pixel of noise, and the points (n, 3) that a camera at `HERE` sees there."""
    pixels = draw.uniform([0, 0], [camera.width - 1, camera.height - 1], (count, 2))
    points = camera.unproject(pixels, draw.uniform(*depths_m, count))
    return pixels + draw.normal(0.0, 0.5, pixels.shape), points


def matches_of(*seen: tuple[NDArray, NDArray]) -> Matches:
    pixels, points = (np.concatenate(each) for each in zip(*seen, strict=True))
    count = len(pixels)
    return Matches(
        points_px=pixels,
        points_in_world=points,
        sigma_m=np.full(count, 0.01),
        query_rows=np.arange(count),
        keyframes=np.zeros(count, np.intp),
        distances=np.full(count, 0.3, np.float32),
        distinct=np.ones(count, bool),
    )


class ByLoRansac:
    """Poses by as many samples as are allowed."""

    def poses(
        self,
        matches: Matches,
        cameras: Sequence[Camera],
        max_iterations: int,
        prior: Pose | None = None,
    ) -> list[PnpEstimate | None]:
        return estimate_poses_lo_ransac(
            matches.points_px,
            matches.points_in_world,
            [(camera, LIMIT_PX * camera.focal_px / CAMERA.focal_px) for camera in cameras],
            max_iterations=max_iterations,
            min_iterations=max_iterations,
            prior=prior,
        )

    def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
        (found,) = self.poses(matches, [camera], 2000, prior)
        return None if found is None else Hypothesis.of(found, matches)


def checked(
    matches: Matches,
    camera: Camera = CAMERA,
    agreeing: int | None = None,
    poses: ByLoRansac | None = None,
) -> CheckedCamera:
    """Return what is made of the pose that the first `agreeing` matches support, all by default."""
    first = matches.take(np.arange(len(matches)) < (agreeing or len(matches)))
    found = ByLoRansac().estimate(first, camera)
    assert found is not None
    mask = np.zeros(len(matches), bool)
    mask[: len(first)] = found.estimate.inlier_mask
    best = Hypothesis.of(replace(found.estimate, inlier_mask=mask), matches)
    return check_intrinsics(best, camera, poses or ByLoRansac(), lambda _: None)


def zoomed(zoom: float) -> Camera:
    fx, fy, *rest = CAMERA.params
    return replace(CAMERA, params=(zoom * fx, zoom * fy, *rest))


def test_matches_of_a_deep_scene_confirm_the_camera() -> None:
    found = checked(matches_of(points_seen(CAMERA, 300, (1.0, 6.0))))
    assert (found.trust, found.camera) == ("confirmed", CAMERA)
    assert found.systematic.position_m < 0.05


def test_matches_at_one_depth_verify_no_camera() -> None:
    found = checked(matches_of(points_seen(CAMERA, 300, (3.0, 3.02))))
    assert found.trust == "open"
    # As a focal length of which nothing is known but what was stated; from picture to picture it is nearly the same.
    assert found.systematic.position_m >= OPTIONS.unseen_sigma * 3.0
    assert found.among is not None
    assert OPTIONS.unseen_sigma * 3.0 > found.among.position_m >= OPTIONS.open_sigma * 3.0


def test_too_few_inliers_to_check_a_camera_by_leave_it_open() -> None:
    few = matches_of(points_seen(CAMERA, OPTIONS.min_features - 1, (2.0, 4.0), np.random.default_rng(6)))
    found = checked(few)
    assert found.trust == "open"
    assert found.systematic.position_m >= OPTIONS.unseen_sigma * 2.0


def test_what_stands_before_and_behind_a_flat_scene_verifies_the_camera() -> None:
    draw = np.random.default_rng(4)
    wall = points_seen(CAMERA, 220, (3.0, 3.1), draw)
    assert checked(matches_of(wall)).trust == "open"
    things = points_seen(CAMERA, 80, (1.0, 6.0), draw)
    found = checked(matches_of(wall, things))
    assert found.trust == "confirmed"
    # Calibrations differ by more than so few things show.
    assert found.among is not None
    assert found.systematic.position_m >= OPTIONS.open_sigma * 3.0 > found.among.position_m


def test_few_inliers_that_agree_with_a_wrong_camera_do_not_confirm_it() -> None:
    few = points_seen(CAMERA, 120, (1.0, 6.0))
    others = points_seen(zoomed(1.75), 300, (1.0, 6.0))
    found = checked(matches_of(few, others), agreeing=120)
    assert found.trust == "refined"
    assert abs(found.camera.focal_px / CAMERA.focal_px - 1.75) < 0.05
    # The same inliers among matches that agree with no camera.
    lost = others[0], rng.permutation(others[1])
    alone = checked(matches_of(few, lost), agreeing=120)
    assert (alone.trust, alone.camera) == ("confirmed", CAMERA)


def test_numbers_of_a_stretched_picture_are_never_sure() -> None:
    fx, fy, *rest = CAMERA.params
    stretched = replace(CAMERA, params=(fx, 1.2 * fy, *rest))
    found = checked(matches_of(points_seen(stretched, 300, (1.0, 6.0))), stretched)
    assert (found.trust, found.camera) == ("open", stretched)


@pytest.mark.parametrize(
    ("seed", "exact", "depths_m"), [(0, 150, (3.0, 3.6)), (3, 40, (3.0, 3.05)), (4, 40, (3.0, 3.05))]
)
def test_inexact_matches_favour_no_longer_lens(seed: int, exact: int, depths_m: tuple[float, float]) -> None:
    draw = np.random.default_rng(seed)
    few = points_seen(CAMERA, exact, depths_m, draw)
    pixels, points = points_seen(CAMERA, 400, depths_m, draw)
    # Were the limit an angle, larger errors in pixels would agree with each longer focal length: 2.2 and 1.19 times.
    found = checked(matches_of(few, (pixels + draw.normal(0.0, 5.0, pixels.shape), points)))
    assert (found.trust == "refined", found.camera) == (False, CAMERA)


def test_a_zoom_that_is_longer_than_refining_may_find_disputes_the_camera() -> None:
    found = checked(matches_of(points_seen(zoomed(2.7), 300, (3.0, 4.0), np.random.default_rng(1))))
    assert (found.trust, found.camera) == ("disputed", CAMERA)


class MissesTheStatedCamera(ByLoRansac):
    """Few samples that find every zoom's pose and never the stated camera's; many find no other camera's."""

    def poses(
        self, matches: Matches, cameras: Sequence[Camera], max_iterations: int, prior: Pose | None = None
    ) -> list[PnpEstimate | None]:
        found = super().poses(matches, cameras, max_iterations, prior)
        is_screen = len(cameras) > 1
        return [
            None if is_screen and own == CAMERA else each for own, each in zip(cameras, found, strict=True)
        ]

    def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
        return super().estimate(matches, camera, prior) if camera == CAMERA else None


@pytest.mark.parametrize(("own", "trust"), [(100, "open"), (40, "disputed")])
def test_a_zoom_disputes_a_camera_only_where_it_rivals_the_pose(own: int, trust: str) -> None:
    draw = np.random.default_rng(3)
    few = points_seen(CAMERA, own, (1.0, 6.0), draw)
    others = points_seen(zoomed(1.75), 60, (1.0, 6.0), draw)
    lost = points_seen(CAMERA, 200, (1.0, 6.0), draw)
    matches = matches_of(few, others, (lost[0], draw.permutation(lost[1])))
    found = checked(matches, agreeing=own, poses=MissesTheStatedCamera())
    assert (found.trust, found.camera) == (trust, CAMERA)


def test_a_refined_camera_is_as_uncertain_as_others_that_fit_about_as_well_differ() -> None:
    seen = points_seen(CAMERA, 300, (1.0, 6.0), np.random.default_rng(2))
    best = ByLoRansac().estimate(matches_of(seen), CAMERA)
    assert best is not None
    chosen = CheckedCamera(camera=CAMERA, best=best, systematic=Accuracy(0.1, 0.0), trust="refined")

    def end(ahead_m: float, turned_deg: float, cost: float) -> Refined:
        turn = cv2.Rodrigues(np.radians([0.0, turned_deg, 0.0]))[0]
        pose = best.pose @ Pose(np.asarray(turn, np.float64), np.array([0.0, 0.0, ahead_m]))
        estimate = replace(best.estimate, world_from_camera=pose)
        other = replace(chosen, best=Hypothesis.of(estimate, best.matches))
        return Refined(other, 100, cost, keeps_centre=True)

    found = Refined(chosen, 100, 50.0, keeps_centre=True)
    worse = end(2.0, 30.0, 50.0 + 101 * OPTIONS.centred_share)
    share = OPTIONS.centred_share
    same = with_spread(found, [found, end(0.05, 1.0, 55.0), worse], share).systematic
    assert (same.position_m, same.orientation_deg) == (0.1, pytest.approx(1.0))
    apart = with_spread(found, [found, end(0.3, 0.5, 55.0), worse], share).systematic
    assert (apart.position_m, apart.orientation_deg) == (pytest.approx(0.3), pytest.approx(0.5))
    # Where most matches agree, only those that fit nearly as well count for the position.
    most = with_spread(found, [found, end(0.3, 0.5, 56.0), worse], OPTIONS.simpler_share).systematic
    assert (most.position_m, most.orientation_deg) == (0.1, pytest.approx(0.5))


def test_a_zoom_keeps_the_principal_point_that_was_stated() -> None:
    found = checked(matches_of(points_seen(zoomed(1.25), 300, (1.0, 6.0))))
    assert found.trust == "refined"
    assert found.camera.params[2:4] == pytest.approx(CAMERA.params[2:4], abs=1e-6)
    assert found.camera.focal_px == pytest.approx(1.25 * CAMERA.focal_px, rel=0.02)
    # Nothing shows that it is so.
    assert found.centre_sigma_px == OPTIONS.centre_sigma_share * CAMERA.width


def test_a_lens_that_is_not_in_the_picture_is_left_out() -> None:
    model = Camera("OPENCV", CAMERA.width, CAMERA.height, (*CAMERA.params[:4], -0.3, 0.1, 0.0, 0.0))
    seen = matches_of(points_seen(CAMERA, 300, (1.0, 6.0)))
    found = checked(seen, model)
    assert (found.trust, found.camera.model) == ("refined", "PINHOLE")
    assert found.camera.focal_px == pytest.approx(CAMERA.focal_px, rel=0.02)
    assert position_difference_m(found.best.pose, HERE) < 0.02


def test_a_principal_point_that_lies_far_away_disputes_the_camera() -> None:
    fx, fy, cx, cy = zoomed(1.25).params[:4]
    aside = replace(CAMERA, params=(fx, fy, cx + 0.25 * CAMERA.width, cy, *CAMERA.params[4:]))
    found = checked(matches_of(points_seen(aside, 300, (1.0, 6.0))))
    assert (found.trust, found.camera) == ("disputed", CAMERA)


def test_a_principal_point_that_lies_elsewhere_is_found() -> None:
    fx, fy, cx, cy = zoomed(1.25).params[:4]
    aside = replace(CAMERA, params=(fx, fy, cx + 0.06 * CAMERA.width, cy, *CAMERA.params[4:]))
    found = checked(matches_of(points_seen(aside, 300, (1.0, 6.0))))
    assert found.trust == "refined"
    assert found.camera.params[2] == pytest.approx(aside.params[2], abs=0.01 * CAMERA.width)
    # Turning the camera by nearly that angle looks the same.
    moved_deg = np.degrees(np.arctan(0.06 * CAMERA.width / fx))
    assert found.systematic.orientation_deg >= 0.9 * OPTIONS.moved_centre_factor * moved_deg


@pytest.mark.parametrize(("zoom", "trust"), [(1.75, "disputed"), (1.12, "open")])
def test_a_zoom_that_more_matches_agree_with_and_none_well_disputes_the_camera(
    zoom: float, trust: str
) -> None:
    few, others = points_seen(CAMERA, 60, (1.0, 6.0)), points_seen(zoomed(zoom), 200, (1.0, 6.0))
    found = ByLoRansac().estimate(matches_of(few), CAMERA)
    assert found is not None
    mask = np.zeros(260, bool)
    mask[:60] = found.estimate.inlier_mask
    best = Hypothesis.of(replace(found.estimate, inlier_mask=mask), matches_of(few, others))

    class RoughOnly(ByLoRansac):
        """No camera is found by refining; the zooms alone are compared."""

        def estimate(self, matches: Matches, camera: Camera, prior: Pose | None = None) -> Hypothesis | None:
            return None

    assert check_intrinsics(best, CAMERA, RoughOnly(), lambda _: None).trust == trust


def test_a_camera_that_nobody_stated_is_less_certain_than_its_matches_say() -> None:
    best = ByLoRansac().estimate(matches_of(points_seen(CAMERA, 300, (1.0, 6.0))), CAMERA)
    assert best is not None
    found = fitted_camera(best, CAMERA)
    assert (found.trust, found.camera) == ("fitted", CAMERA)
    assert found.centre_sigma_px > 0
    assert found.systematic.position_m == pytest.approx(OPTIONS.fitted_sigma * 3.5, rel=0.3)


def test_inliers_that_the_first_pose_missed_are_no_gain_of_another_camera() -> None:
    # Nearly all agree with the stated camera as well, and the first pose has two thirds of them.
    found = checked(matches_of(points_seen(zoomed(1.02), 300, (1.0, 6.0))), agreeing=200)
    assert (found.trust, found.camera) == ("contradicted", CAMERA)


def test_zooms_are_those_that_a_lens_can_have() -> None:
    wide, long = (Camera("PINHOLE", 640, 480, (f, f, 320.0, 240.0)) for f in (100.0, 7000.0))
    assert [each.focal_px for each in zoomed_cameras(wide, (0.57, 0.89, 2.2))] == pytest.approx([89.0, 220.0])
    assert [each.focal_px for each in zoomed_cameras(long, (0.57, 0.89, 2.2))] == pytest.approx([3990, 6230])


def test_refining_starts_at_no_camera_that_a_lens_can_not_have() -> None:
    """The focal length that was searched for is possible, but not with the stated ratio of both."""
    camera = Camera("PINHOLE", 640, 480, (1000.0, 700.0, 320.0, 240.0))
    fit, best = (
        SimpleNamespace(log_focal=2 * OPTIONS.search_log, focal_sigma=0.0),
        SimpleNamespace(matches=None),
    )
    starts = _starts(cast(Any, best), camera, cast(Any, fit), lambda _: pinhole(640, 480, 7300.0), None)
    assert next(starts).camera == square_pixels(camera)[0]
