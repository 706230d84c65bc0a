"""A phone on the plan by a monitoring camera: exact worlds, every vertical, and what leaves the answer open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError
from app.geometry.anchor_pose import KnownScale, PoiSight, solve_anchor, solve_calibrated
from app.geometry.se3 import Pose
from tests.scenes import pose_at

Array = NDArray[np.float64]

MONITOR = pose_at(4.0, 3.0, 2.5, 30.0, -20.0)
DOWN = np.array([0.0, 0.0, -1.0])
POIS = ([7.0, 4.0, 1.2], [8.0, 6.5, 1.8], [6.0, 6.0, 0.9])
UNIT = 0.37


def sight(point: list[float], *, error: float = 0.0, known_height: bool = False) -> PoiSight:
    """Return a POI that the camera sees, its distance by triangulation in units of 0.37 m, off by `error`."""
    offset = np.array(point) - MONITOR.translation
    distance = float(np.linalg.norm(offset))
    ray = MONITOR.rotation.T @ offset / distance
    length = distance / UNIT * float(np.exp(error))
    height = float(offset[2]) if known_height else None
    return PoiSight(
        ray_in_monitor=ray,
        on_plan=np.array(point[:2]),
        distance_m=distance,
        length=length,
        log_sigma=0.05,
        height_offset_m=height,
    )


def relative(phone: Pose) -> Pose:
    """Return `phone_from_monitor` in units of 0.37 m."""
    metric = phone.inverse() @ MONITOR
    return Pose(metric.rotation, metric.translation / UNIT)


@pytest.mark.parametrize("tilt_deg", [0.0, -30.0, 25.0])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_with_gravity_the_phone_is_where_it_is(tilt_deg: float, count: int) -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0, tilt_deg)
    sights = [sight(point) for point in POIS[:count]]
    found = solve_anchor(MONITOR.translation[:2], 2.5, relative(phone), sights, phone.rotation.T @ DOWN)
    assert found.vertical == "gravity"
    assert found.metres_per_unit == pytest.approx(UNIT)
    assert np.allclose(found.plan_from_phone.translation, phone.translation, atol=1e-6)
    assert np.allclose(found.plan_from_phone.rotation, phone.rotation, atol=1e-6)
    assert found.poi_errors_m.max() < 1e-6


def test_the_turn_has_a_sign() -> None:
    for x, y in ((2.0, 1.0), (2.0, 5.5)):
        phone = pose_at(x, y, 1.5, 40.0)
        found = solve_anchor(
            MONITOR.translation[:2], 2.5, relative(phone), [sight(POIS[0])], phone.rotation.T @ DOWN
        )
        assert np.allclose(found.plan_from_phone.translation[:2], [x, y], atol=1e-6)


def test_an_upright_phone_needs_no_gravity_and_is_less_sure() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0)
    args = MONITOR.translation[:2], 2.5, relative(phone), [sight(POIS[0])]
    assumed, known = solve_anchor(*args), solve_anchor(*args, phone.rotation.T @ DOWN)
    assert assumed.vertical == "upright"
    assert np.linalg.norm(assumed.plan_from_phone.translation - phone.translation) < 1e-3
    assert np.trace(assumed.plan_from_monitor_covariance) > np.trace(known.plan_from_monitor_covariance)


def test_pois_in_several_directions_hold_the_vertical() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0, -20.0)
    sights = [sight(point, known_height=True) for point in POIS]
    found = solve_anchor(MONITOR.translation[:2], 2.5, relative(phone), sights)
    assert found.vertical == "pois"
    assert np.linalg.norm(found.plan_from_phone.translation[:2] - phone.translation[:2]) < 0.1


def test_one_poi_that_was_moved_does_not_drag_the_others_along() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0)
    sights = [*(sight(point) for point in POIS), sight([9.0, 4.5, 1.5], error=0.8)]
    found = solve_anchor(MONITOR.translation[:2], 2.5, relative(phone), sights, phone.rotation.T @ DOWN)
    assert found.metres_per_unit == pytest.approx(UNIT, rel=0.03)
    assert abs(found.scale_errors[-1]) > 0.7


def test_a_poi_that_the_phone_does_not_see_turns_the_camera_and_the_room_gives_the_scale() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0, -10.0)
    unseen = replace(sight(POIS[0]), length=None)
    args = MONITOR.translation[:2], 2.5, relative(phone), [unseen], phone.rotation.T @ DOWN
    with pytest.raises(DegenerateGeometryError):
        solve_anchor(*args)
    found = solve_anchor(*args, lambda _: KnownScale(float(np.log(UNIT)), 0.1))
    assert np.allclose(found.plan_from_phone.translation, phone.translation, atol=1e-6)
    assert found.log_scale_sigma == pytest.approx(0.1)
    assert len(found.scale_errors) == 0
    assert found.room_sigmas is None


def test_pois_and_room_give_the_scale_together_and_say_how_they_differ() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0)
    args = MONITOR.translation[:2], 2.5, relative(phone), [sight(POIS[0])], phone.rotation.T @ DOWN
    alone = solve_anchor(*args)
    both = solve_anchor(*args, lambda _: KnownScale(float(np.log(UNIT)) + 0.3, 0.1))
    assert alone.room_sigmas is None
    assert both.room_sigmas == pytest.approx(0.3 / np.hypot(0.1, np.hypot(0.05, 0.015)))
    assert UNIT < both.metres_per_unit < UNIT * np.exp(0.3)
    assert both.log_scale_sigma < alone.log_scale_sigma
    assert len(both.scale_errors) == 1


def test_what_leaves_the_plan_open_is_refused() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0)
    with pytest.raises(DegenerateGeometryError):
        solve_anchor(MONITOR.translation[:2], 2.5, relative(phone), [])
    below = sight([4.0, 3.0, 0.0])
    with pytest.raises(DegenerateGeometryError):
        solve_anchor(MONITOR.translation[:2], 2.5, relative(phone), [below], phone.rotation.T @ DOWN)


def test_a_calibrated_camera_needs_distances_alone() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0, -30.0)
    lengths = np.array([4.0, 5.0, 6.0, 4.5, 5.5, 50.0])
    known = UNIT * np.array([*lengths[:5], np.nan])
    found = solve_calibrated(MONITOR, 0.01, relative(phone), known, lengths)
    assert found.vertical == "map"
    assert np.allclose(found.plan_from_phone.translation, phone.translation, atol=1e-9)
    assert found.length_scatter == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(DegenerateGeometryError):
        solve_calibrated(MONITOR, 0.01, relative(phone), known[2:], lengths[2:])


def test_map_and_pois_hold_the_scale_of_a_calibrated_camera_together() -> None:
    phone = pose_at(5.5, 2.0, 1.5, 50.0, -30.0)
    lengths = np.array([4.0, 5.0, 6.0, 4.5, 5.5])
    none = np.full(5, np.nan)
    by_pois = solve_calibrated(MONITOR, 0.01, relative(phone), none, lengths, [sight(POIS[0])])
    assert by_pois.metres_per_unit == pytest.approx(UNIT)
    wrong = solve_calibrated(
        MONITOR, 0.01, relative(phone), 1.5 * UNIT * lengths, lengths, [sight(POIS[0]), sight(POIS[1])]
    )
    assert np.abs(wrong.scale_errors).max() > 0.3
    uneven = UNIT * lengths * np.array([0.6, 0.8, 1.0, 1.3, 1.7])
    assert solve_calibrated(MONITOR, 0.01, relative(phone), uneven, lengths).length_scatter > 0.2
