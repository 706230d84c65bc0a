"""The relative pose to a monitoring camera, with both verticals or by the matches alone."""

from __future__ import annotations

import numpy as np
import pytest

from app.engine.anchors.matching import PixelMatches
from app.engine.anchors.relative_pose import instability_deg, known_verticals, phone_beside_monitor
from app.geometry.se3 import rotation_angle_deg, rotation_from_vector
from tests.synthetic import TwoViews, make_two_views

DOWN = np.array([0.05, 0.98, 0.2]) / np.linalg.norm([0.05, 0.98, 0.2])


def two_views(seed: int, outlier_ratio: float) -> tuple[TwoViews, PixelMatches]:
    views = make_two_views(np.random.default_rng(seed), n=500, noise_px=0.4, outlier_ratio=outlier_ratio)
    return views, PixelMatches(views.points_a_px, views.points_b_px, np.full(500, np.nan))


def test_verticals_need_both_sides() -> None:
    assert known_verticals(None, DOWN) is None
    assert known_verticals(DOWN, None) is None
    known = known_verticals(DOWN, 9.81 * DOWN)
    assert known is not None
    assert np.linalg.norm(known.in_b) == pytest.approx(1.0)
    mounted = known_verticals(DOWN, DOWN, 1e-4)
    assert mounted is not None
    assert mounted.sigma_rad < known.sigma_rad


@pytest.mark.parametrize("outlier_ratio", [0.3, 0.7])
def test_right_verticals_hold_the_pose(outlier_ratio: float) -> None:
    views, matches = two_views(1, outlier_ratio)
    cameras = views.camera_a, views.camera_b
    known = known_verticals(DOWN, views.b_from_a.rotation @ DOWN)
    found = phone_beside_monitor(matches, cameras, known)
    assert found is not None
    assert found.verticals is known
    assert found.information is not None
    assert rotation_angle_deg(found.estimate.b_from_a.rotation.T @ views.b_from_a.rotation) < 1.0
    assert instability_deg(matches, cameras, found, 10_000) < 3.0
    assert instability_deg(matches, cameras, found, 50) == 0.0


def test_a_wrong_vertical_is_set_aside() -> None:
    views, matches = two_views(2, 0.4)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ views.b_from_a.rotation @ DOWN
    found = phone_beside_monitor(matches, (views.camera_a, views.camera_b), known_verticals(DOWN, turned))
    assert found is not None
    assert found.verticals is None
    assert found.information is None
    assert rotation_angle_deg(found.estimate.b_from_a.rotation.T @ views.b_from_a.rotation) < 1.0


def test_the_gravity_of_a_shaken_phone_is_set_aside() -> None:
    views, matches = two_views(4, 0.4)
    shaken = rotation_from_vector([0.1, 0.0, 0.12]) @ views.b_from_a.rotation @ DOWN
    found = phone_beside_monitor(matches, (views.camera_a, views.camera_b), known_verticals(DOWN, shaken))
    assert found is not None
    assert rotation_angle_deg(found.estimate.b_from_a.rotation.T @ views.b_from_a.rotation) < 1.0


def test_chance_is_not_stable() -> None:
    views, matches = two_views(3, 1.0)
    cameras = views.camera_a, views.camera_b
    found = phone_beside_monitor(matches, cameras, known_verticals(DOWN, DOWN))
    assert found is None or instability_deg(matches, cameras, found, 400) > 20.0
