"""The likeness of an anchor to an image, the verification of its fix, and the stored form of its features."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np

from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.fix import AnchorEvidence, AnchorFix, _scale_error
from app.engine.anchors.locator import ranked
from app.engine.anchors.matching import PixelMatches, likeness
from app.engine.anchors.poi_triangulation import reliable
from app.engine.anchors.verification import OPTIONS, judge_fix
from app.geometry.anchor_pose import AnchorSolution, PoiSight, Vertical
from app.geometry.se3 import Pose
from app.vision.features import LocalFeatures


def features(descriptors: np.ndarray) -> AnchorFeatures:
    points = np.zeros((len(descriptors), 2), np.float32)
    akaze = LocalFeatures(points[:0], np.zeros((0, 61), np.uint8))
    return AnchorFeatures(
        akaze=akaze, xfeat=LocalFeatures(points, descriptors.astype(np.float32)), words=np.zeros(0, np.int64)
    )


def test_likeness_counts_similar_features() -> None:
    rng = np.random.default_rng(0)
    seen, other = rng.normal(size=(80, 64)), rng.normal(size=(120, 64))
    phone = features(seen + 0.1 * rng.normal(size=seen.shape))
    same, different = features(np.concatenate([seen, other])), features(other)
    assert likeness(same, phone) >= 75
    assert likeness(different, phone) < 5
    assert likeness(features(other[:0]), phone) == 0


def test_ranked_keeps_the_order_of_equals() -> None:
    assert ranked([3, 9, 3, 12]) == [3, 1, 0, 2]


def test_one_moved_poi_of_three_is_outvoted_but_one_of_two_is_not() -> None:
    assert _scale_error(np.zeros(0)) == 0.0
    assert _scale_error(np.array([0.01, -0.02, 0.9])) == 0.02
    assert _scale_error(np.array([-0.3, 0.1])) == 0.3


def fix(vertical: Vertical, instability_sigma_m: float = 0.0, **changes: Any) -> AnchorFix:
    """Return a fix that is accepted, with some of its evidence changed."""
    still = Pose(np.eye(3), np.zeros(3))
    none = np.zeros(0)
    solution = AnchorSolution(
        plan_from_phone=still,
        plan_from_monitor=still,
        metres_per_unit=1.0,
        log_scale_sigma=0.05,
        plan_from_monitor_covariance=np.zeros((3, 3)),
        poi_errors_m=none,
        scale_errors=none,
        vertical=vertical,
    )
    evidence = replace(
        AnchorEvidence(
            matches=800,
            inliers=500,
            coverage=0.6,
            region_matches=60,
            parallax_deg=12.0,
            poi_error_share=0.1,
            scale_error=0.01,
            log_scale_sigma=0.05,
            instability_deg=0.0,
        ),
        **changes,
    )
    matches = PixelMatches(np.zeros((0, 2)), np.zeros((0, 2)), none)
    return AnchorFix(
        solution=solution,
        evidence=evidence,
        position_covariance=1e-3 * np.eye(3),
        orientation_sigma_deg=1.0,
        inliers=matches,
        instability_sigma_m=instability_sigma_m,
    )


def test_pois_that_disagree_on_the_scale_make_an_answer_ambiguous() -> None:
    assert judge_fix(fix("gravity")) is None
    assert judge_fix(fix("gravity", scale_error=OPTIONS.max_scale_error + 0.01)) == "ambiguous"


def test_a_room_that_contradicts_the_pois_makes_an_answer_ambiguous() -> None:
    assert judge_fix(fix("gravity", room_sigmas=OPTIONS.max_room_sigmas - 0.1)) is None
    assert judge_fix(fix("gravity", room_sigmas=OPTIONS.max_room_sigmas + 0.1)) == "ambiguous"


def test_a_phone_where_nobody_holds_one_is_not_placed() -> None:
    assert judge_fix(fix("gravity", is_held=False)) == "ambiguous"


def test_a_poi_is_outvoted_only_by_a_steady_pose() -> None:
    moved = {"worst_scale_error": 0.6}
    assert judge_fix(fix("gravity", instability_deg=2.0, **moved)) is None
    assert judge_fix(fix("gravity", instability_deg=15.0)) is None
    assert judge_fix(fix("gravity", instability_deg=15.0, **moved)) == "ambiguous"


def test_a_pose_that_verticals_hold_needs_fewer_matches_and_steadier_halves() -> None:
    assert judge_fix(fix("gravity", matches=2500)) == "too_few_inliers"
    assert judge_fix(fix("gravity", matches=2500, is_upright=True)) is None
    assert judge_fix(fix("gravity", instability_deg=15.0, is_upright=True)) == "ambiguous"


def test_a_poi_hardly_seen_says_nothing_against_another() -> None:
    clear, faint = (
        PoiSight(
            ray_in_monitor=np.array([0.0, 0.0, 1.0]),
            on_plan=np.zeros(2),
            distance_m=3.0,
            length=1.0,
            log_sigma=sigma,
        )
        for sigma in (0.07, 0.3)
    )
    assert reliable([(clear, 80), (faint, 4)]) == [(clear, 80)]
    assert reliable([(faint, 4)]) == [(faint, 4)]


def test_of_a_calibrated_camera_map_and_pois_must_agree() -> None:
    assert judge_fix(fix("map")) is None
    assert judge_fix(fix("map", worst_scale_error=OPTIONS.max_scale_error + 0.01)) == "ambiguous"
    assert judge_fix(fix("map", instability_sigma_m=0.6)) == "too_few_inliers"
    assert judge_fix(fix("gravity", instability_sigma_m=0.6)) is None
    assert judge_fix(fix("gravity", instability_sigma_m=0.8)) == "too_few_inliers"


def test_what_the_choice_of_matches_moves_is_part_of_the_accuracy() -> None:
    steady, unsteady = fix("gravity"), fix("gravity", instability_sigma_m=0.3)
    assert steady.position_sigma_m == steady.noise_sigma_m == unsteady.noise_sigma_m
    assert np.isclose(unsteady.position_sigma_m**2, steady.noise_sigma_m**2 + 0.09)
    assert np.isclose(np.trace(unsteady.full_covariance[:2, :2]), unsteady.position_sigma_m**2)


def test_what_an_earlier_version_packed_is_not_read() -> None:
    rng = np.random.default_rng(0)
    packed = features(rng.normal(size=(3, 64)))
    again = AnchorFeatures.unpack(packed.pack())
    assert again is not None
    assert np.allclose(again.xfeat.descriptors, packed.xfeat.descriptors, atol=1e-2)
    assert again.down is None
    tilted = AnchorFeatures.unpack(replace(packed, down=np.array([0.0, 0.8, 0.6])).pack())
    assert tilted is not None
    assert np.array_equal(tilted.down, [0.0, 0.8, 0.6])
    buffer = io.BytesIO()
    np.savez(buffer, words=np.zeros(1000, np.float16))
    assert AnchorFeatures.unpack(buffer.getvalue()) is None
