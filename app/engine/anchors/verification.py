"""Whether an anchor's answer can be trusted, and how sure that makes us (measured: docs/anchors.md)."""

from __future__ import annotations

import numpy as np

from app.engine.anchors.fix import AnchorEvidence, AnchorFix
from app.engine.anchors.poi_triangulation import MAX_LOG_SCALE_SIGMA
from app.engine.anchors.relative_pose import MIN_INLIERS, min_inlier_ratio
from app.engine.query.verification import Reason

MIN_COVERAGE = 0.15
# Of this much where so many inliers agree, less in proportion where fewer do.
MAX_INSTABILITY_DEG, STEADY_INLIERS = 20.0, 200
# Where both verticals hold the pose, halves of right matches hardly ever differ by more.
MAX_INSTABILITY_UPRIGHT_DEG, STEADY_UPRIGHT_INLIERS = 10.0, 300
MIN_PARALLAX_DEG = 1.0
# By noise alone, and by the choice of matches too; of a calibrated camera the first holds for both.
MAX_POSITION_SIGMA_M, MAX_UNSTEADY_SIGMA_M = 0.4, 0.7
# POIs in two directions see different lengths of the same wrong pose.
MAX_SCALE_ERROR = 0.1
# Where one disagrees it was moved, or the pose is wrong: only a steady pose says which.
MAX_INSTABILITY_OUTVOTED_DEG = 6.0


def judge_fix(fix: AnchorFix) -> Reason | None:
    """Return why an answer can't be trusted, or None if it can.

    Of a calibrated camera all must agree on the scale, the map and each POI.
    """
    evidence = fix.evidence
    max_sigma_m = MAX_POSITION_SIGMA_M if fix.is_calibrated else MAX_UNSTEADY_SIGMA_M
    scale_error = evidence.worst_scale_error if fix.is_calibrated else evidence.scale_error
    failed: tuple[tuple[bool, Reason], ...] = (
        (evidence.inliers < MIN_INLIERS, "too_few_inliers"),
        (evidence.inlier_ratio < min_inlier_ratio(evidence.is_upright), "too_few_inliers"),
        (evidence.coverage < MIN_COVERAGE, "too_few_inliers"),
        (evidence.parallax_deg < MIN_PARALLAX_DEG, "too_few_inliers"),
        (evidence.log_scale_sigma > MAX_LOG_SCALE_SIGMA, "too_few_inliers"),
        (fix.noise_sigma_m > MAX_POSITION_SIGMA_M, "too_few_inliers"),
        (fix.position_sigma_m > max_sigma_m, "too_few_inliers"),
        (scale_error > MAX_SCALE_ERROR, "ambiguous"),
        (evidence.poi_error_share > 1.0, "ambiguous"),
        (evidence.instability_deg > _max_instability_deg(evidence), "ambiguous"),
    )
    return next((reason for fails, reason in failed if fails), None)


def _max_instability_deg(evidence: AnchorEvidence) -> float:
    enough, limit_deg = STEADY_INLIERS, MAX_INSTABILITY_DEG
    if evidence.is_upright:
        enough, limit_deg = STEADY_UPRIGHT_INLIERS, MAX_INSTABILITY_UPRIGHT_DEG
    if evidence.worst_scale_error > MAX_SCALE_ERROR:
        limit_deg = MAX_INSTABILITY_OUTVOTED_DEG
    return min(1.0, evidence.inliers / enough) * limit_deg


def confidence_of_fix(fix: AnchorFix) -> float:
    """Return the probability that an answer is off by less than 0.5 m and 5 degrees.

    A logistic curve fitted to 236 answers on pairs of real frames, of which 98 % were.
    """
    sigma_m = max(fix.noise_sigma_m, 0.01)
    score = -0.87 - 1.41 * np.log(sigma_m) + 1.41 * np.log(max(fix.evidence.inliers, 1) / 100.0)
    return float(1.0 / (1.0 + np.exp(-score)))
