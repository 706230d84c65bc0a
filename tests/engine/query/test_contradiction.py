"""What in a picture speaks against a pose."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.query.contradiction import contradicted_share
from app.vision.matching import to_unit_vectors
from tests.maps import map_of
from tests.scenes import CAMERA, pose_at

HERE = pose_at(0.0, 0.0)
COUNT = 4000
rng = np.random.default_rng(0)
PIXELS = rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (COUNT, 2))
# SIFT's numbers are few large and many small ones.
PRINTS = (rng.exponential(30, (2, COUNT, 128)) ** 1.5 / 10).clip(0, 255).astype(np.uint8)
POINTS = HERE.apply(CAMERA.unproject(PIXELS, np.full(COUNT, 2.0)))
MAP = map_of([HERE], [POINTS], [PRINTS[0]])
LEFT = PIXELS[:, 0] < CAMERA.width / 2


def share(
    features: np.ndarray, inliers: np.ndarray, prints: np.ndarray = PRINTS[0], seen_from_m: float = 0.0
) -> float:
    pose = pose_at(seen_from_m, 0.0)
    unit = to_unit_vectors(prints[features], binary=False)
    return contradicted_share(MAP, [0], pose, CAMERA, (PIXELS[features], unit), PIXELS[inliers], False)


def test_what_is_there_contradicts_nothing() -> None:
    assert share(np.full(COUNT, True), LEFT) == 0.0


def test_another_print_where_the_map_has_one_contradicts() -> None:
    changed = np.where(LEFT[:, None], PRINTS[0], PRINTS[1])
    assert share(np.full(COUNT, True), LEFT, changed) == pytest.approx(0.5, abs=0.02)


def test_what_is_hidden_contradicts_nothing() -> None:
    assert share(LEFT, LEFT) == 0.0


def test_what_was_scanned_from_far_away_is_not_expected() -> None:
    # At half the distance the picture shows other features than the keyframe does.
    assert share(np.full(COUNT, True), LEFT, PRINTS[1], seen_from_m=1.0) == 0.0


def test_a_pose_that_no_keyframe_shares_a_view_with_is_not_judged() -> None:
    features = PIXELS, to_unit_vectors(PRINTS[1], binary=False)
    assert contradicted_share(MAP, [], HERE, CAMERA, features, PIXELS[LEFT], False) == 0.0
