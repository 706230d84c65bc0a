"""Whether an anchor's answer can be trusted, and how sure that makes us."""

from __future__ import annotations

import numpy as np

from app.services.anchor_fix import AnchorFix
from app.services.verification import Reason

MIN_INLIERS = 60
MIN_COVERAGE = 0.15
MAX_POSITION_SIGMA_M = 0.4
MAX_LOG_SCALE_SIGMA = 0.25
# A POI may come out this far from its place: this much, and this share of its distance.
MAX_POI_ERROR_M, MAX_POI_ERROR_SHARE = 0.25, 0.08


def judge_fix(fix: AnchorFix) -> Reason | None:
    """Return why an answer can't be trusted, or None if it can."""
    evidence = fix.evidence
    if evidence.inliers < MIN_INLIERS or evidence.coverage < MIN_COVERAGE:
        return "too_few_inliers"
    if fix.position_sigma_m > MAX_POSITION_SIGMA_M or evidence.log_scale_sigma > MAX_LOG_SCALE_SIGMA:
        return "too_few_inliers"
    return None


def confidence_of_fix(fix: AnchorFix) -> float:
    """Return the probability that an answer is off by less than 0.5 m and 5 degrees."""
    score = 1.8 * np.log(max(fix.evidence.inliers, 1) / 60.0) + 1.0
    return float(1.0 / (1.0 + np.exp(-score)))
