"""Which anchor looks like a picture, and when POIs speak against an answer."""

from __future__ import annotations

import numpy as np

from app.services.anchor_features import AnchorFeatures, likeness
from app.services.anchor_fix import AnchorEvidence, AnchorFix, _scale_error
from app.services.anchor_locator import ranked
from app.services.anchor_verification import MAX_SCALE_ERROR, judge_fix
from app.vision.local_features import LocalFeatures


def features(descriptors: np.ndarray) -> AnchorFeatures:
    points = np.zeros((len(descriptors), 2), np.float32)
    akaze = LocalFeatures(points[:0], np.zeros((0, 61), np.uint8))
    return AnchorFeatures(
        akaze, LocalFeatures(points, descriptors.astype(np.float32)), np.zeros(4, np.float32)
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


def evidence(scale_error: float) -> AnchorEvidence:
    return AnchorEvidence(800, 500, 0.6, 60, 12.0, 0.1, scale_error, 0.05, 0.0)


def test_pois_that_disagree_on_the_scale_make_an_answer_ambiguous() -> None:
    for scale_error, reason in ((0.01, None), (MAX_SCALE_ERROR + 0.01, "ambiguous")):
        fix = AnchorFix(None, evidence(scale_error), 1e-3 * np.eye(3), 1.0, None)  # type: ignore[arg-type]
        assert judge_fix(fix) == reason
