"""Verification of an anchor's fix, and its confidence (measured: docs/anchors.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.anchors.fix import AnchorEvidence, AnchorFix
from app.engine.anchors.poi_triangulation import OPTIONS as TRIANGULATION_OPTIONS
from app.engine.anchors.relative_pose import OPTIONS as RELATIVE_POSE_OPTIONS
from app.engine.anchors.relative_pose import min_inlier_ratio
from app.engine.query.verification import Reason
from app.limits import limit

SEEDS_1_TO_3 = (
    "Measured: `roomfix evaluate-anchors --demo DIR --count 100`, seeds 1 to 3 (docs/anchors.md, Figures)."
)
SEEDS_1_TO_4 = (
    "Measured: `roomfix evaluate-anchors --demo DIR --count 100`, seeds 1 to 4 (docs/anchors.md, Figures)."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FixVerificationOptions:
    """What a fix must pass."""

    min_coverage: float = limit(
        0.15, "Least fraction of the phone image's grid cells that hold inliers.", chosen=SEEDS_1_TO_3
    )
    max_instability_deg: float = limit(
        20.0,
        "Largest difference of a free relative pose by half of the matches, with at least `stable_inliers` inliers; "
        "with fewer it is smaller in proportion.",
        chosen=SEEDS_1_TO_4,
    )
    stable_inliers: int = limit(
        200, "Number of inliers from which `max_instability_deg` holds in full.", chosen=SEEDS_1_TO_4
    )
    max_upright_instability_deg: float = limit(
        10.0,
        "Largest difference of an upright relative pose by half of the matches, with at least "
        "`stable_upright_inliers` inliers; with fewer it is smaller in proportion.",
        chosen="Measured: halves of correct matches hardly ever differ by more; the command is not recorded.",
    )
    stable_upright_inliers: int = limit(
        300,
        "Number of inliers from which `max_upright_instability_deg` holds in full.",
        chosen="By hand; no measurement is recorded.",
    )
    max_outvoted_instability_deg: float = limit(
        6.0,
        "The same where a POI's scale differs from that of the others, with either kind of pose.",
        chosen="By hand: either the POI was moved or the pose is wrong, which only a stable pose can decide.",
    )
    min_parallax_deg: float = limit(1.0, "Least median parallax of the inliers.", chosen=SEEDS_1_TO_3)
    max_noise_sigma_m: float = limit(
        0.4,
        "Largest standard deviation of the position by noise; of a calibrated camera also that with instability.",
        chosen=SEEDS_1_TO_3,
    )
    max_unstable_sigma_m: float = limit(
        0.7,
        "Largest standard deviation of the position by noise and instability, of a camera that is not calibrated.",
        chosen=SEEDS_1_TO_3,
    )
    near_noise_sigma_m: float = limit(
        0.8,
        "`max_noise_sigma_m` of a phone that is known to be near, or of a fix that a second one has to confirm.",
        chosen="Recorded walks of roomfix simulate --no-map: the errors of such fixes were below their sigmas.",
    )
    near_unstable_sigma_m: float = limit(
        1.0,
        "`max_unstable_sigma_m` of the same.",
        chosen="By hand: as near_noise_sigma_m.",
    )
    max_scale_error: float = limit(
        0.1,
        "Largest difference between the logarithms of the scale of most POIs and of the common scale.",
        chosen=SEEDS_1_TO_4,
    )
    max_room_sigmas: float = limit(
        3.0,
        "Largest difference between the scales by POIs and by the room, in standard deviations.",
        chosen="By hand: the usual limit between noise and outlier.",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FixConfidenceOptions:
    """The logistic regression of a fix's confidence on its accuracy and inliers."""

    intercept: float = limit(
        -0.87,
        "Intercept of the regression.",
        chosen="Measured: fitted to 236 answers on pairs of real frames, of which 98 % were correct.",
    )
    log_sigma_weight: float = limit(
        1.41,
        "Weight of minus the logarithm of the position's standard deviation in metres, by noise alone.",
        chosen="Measured: fitted to 236 answers on pairs of real frames, of which 98 % were correct.",
    )
    log_inliers_weight: float = limit(
        1.41,
        "Weight of the logarithm of the number of inliers, divided by 100.",
        chosen="Measured: fitted to 236 answers on pairs of real frames, of which 98 % were correct.",
    )
    min_sigma_m: float = limit(
        0.01,
        "Least standard deviation of the position that is put into the regression.",
        chosen="By hand; no measurement is recorded.",
    )


OPTIONS = FixVerificationOptions()
CONFIDENCE_OPTIONS = FixConfidenceOptions()


def judge_fix(fix: AnchorFix, may_be_rough: bool = False) -> Reason | None:
    """Return why a fix is rejected, or None where it is accepted.

    Of a calibrated camera the map and every POI must agree on the scale, else most of the POIs. A fix `may_be_rough`
    of a phone that is known to be near, and where a second fix has to confirm it.
    """
    evidence = fix.evidence
    max_noise_m, max_sigma_m = OPTIONS.max_noise_sigma_m, OPTIONS.max_unstable_sigma_m
    if may_be_rough:
        max_noise_m, max_sigma_m = OPTIONS.near_noise_sigma_m, OPTIONS.near_unstable_sigma_m
    if fix.is_calibrated:
        max_sigma_m = max_noise_m
    scale_error = evidence.worst_scale_error if fix.is_calibrated else evidence.scale_error
    failed: tuple[tuple[bool, Reason], ...] = (
        (evidence.inliers < RELATIVE_POSE_OPTIONS.min_inliers, "too_few_inliers"),
        (evidence.inlier_ratio < min_inlier_ratio(evidence.is_upright), "too_few_inliers"),
        (evidence.coverage < OPTIONS.min_coverage, "too_few_inliers"),
        (evidence.parallax_deg < OPTIONS.min_parallax_deg, "too_few_inliers"),
        (evidence.log_scale_sigma > TRIANGULATION_OPTIONS.max_log_scale_sigma, "too_few_inliers"),
        (fix.noise_sigma_m > max_noise_m, "too_few_inliers"),
        (fix.position_sigma_m > max_sigma_m, "too_few_inliers"),
        (scale_error > OPTIONS.max_scale_error, "ambiguous"),
        (evidence.poi_error_share > 1.0, "ambiguous"),
        (evidence.room_sigmas > OPTIONS.max_room_sigmas, "ambiguous"),
        (not evidence.is_held, "ambiguous"),
        (not is_stable(evidence), "ambiguous"),
    )
    return next((reason for fails, reason in failed if fails), None)


def is_stable(evidence: AnchorEvidence) -> bool:
    """Return whether enough matches agree, and their halves give nearly the same relative pose."""
    enough = evidence.inliers >= RELATIVE_POSE_OPTIONS.min_inliers
    return enough and evidence.instability_deg <= _max_instability_deg(evidence)


def _max_instability_deg(evidence: AnchorEvidence) -> float:
    enough, limit_deg = OPTIONS.stable_inliers, OPTIONS.max_instability_deg
    if evidence.is_upright:
        enough, limit_deg = OPTIONS.stable_upright_inliers, OPTIONS.max_upright_instability_deg
    if evidence.worst_scale_error > OPTIONS.max_scale_error:
        limit_deg = OPTIONS.max_outvoted_instability_deg
    return min(1.0, evidence.inliers / enough) * limit_deg


def confidence_of_fix(fix: AnchorFix) -> float:
    """Return the probability that a fix is within 0.5 m and 5 degrees of the true pose, by logistic regression."""
    options = CONFIDENCE_OPTIONS
    sigma_m = max(fix.noise_sigma_m, options.min_sigma_m)
    inliers = max(fix.evidence.inliers, 1) / 100.0
    score = options.intercept - options.log_sigma_weight * np.log(sigma_m)
    score += options.log_inliers_weight * np.log(inliers)
    return float(1.0 / (1.0 + np.exp(-score)))
