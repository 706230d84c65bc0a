import numpy as np
import pytest

from app.geometry.geodesy import (
    ECCENTRICITY_SQUARED,
    SEMI_MAJOR_AXIS_M,
    east_north_from_geodetic,
    enu_from_earth,
    enu_from_geodetic,
    geodetic_from_east_north,
    geodetic_from_enu,
)


def test_an_arc_of_the_equator_and_of_a_meridian():
    degree_m = np.pi / 180 * SEMI_MAJOR_AXIS_M
    east, north = east_north_from_geodetic([[10.001, 0.0]], [10.0, 0.0])[0]
    assert (east, north) == (pytest.approx(degree_m / 1000, rel=1e-6), pytest.approx(0.0, abs=1e-6))
    # A degree of latitude is 110,574 m long at the equator, 111,694 m at the pole.
    assert east_north_from_geodetic([[0, 0.001]], [0, 0])[0, 1] == pytest.approx(110.574, abs=1e-3)
    assert east_north_from_geodetic([[0, 89.001]], [0, 89])[0, 1] == pytest.approx(111.694, abs=1e-3)


def test_distances_do_not_depend_on_the_origin():
    rng = np.random.default_rng(3)
    points = np.array([-2.978, 56.46]) + rng.uniform(-0.001, 0.001, (20, 2))
    here, there = (east_north_from_geodetic(points, origin) for origin in (points[0], points[-1]))
    apart = [np.linalg.norm(xy[:, None] - xy[None], axis=-1) for xy in (here, there)]
    assert np.abs(apart[0] - apart[1]).max() < 1e-4
    assert np.allclose(here[0], 0)


@pytest.mark.parametrize("origin", [(-2.978, 56.46), (139.7, -33.0), (10.0, 0.0), (25.0, 78.0)])
def test_the_inverse_gives_the_same_metres(origin):
    points = np.random.default_rng(5).uniform(-5000, 5000, (50, 2))
    back = east_north_from_geodetic(geodetic_from_east_north(points, origin), origin)
    assert np.abs(back - points).max() < 1e-6


def test_geodetic_positions_of_known_earth_centred_points():
    # On the axes of the ellipsoid its radii are a and b = a sqrt(1 - e^2).
    pole_m = SEMI_MAJOR_AXIS_M * np.sqrt(1 - ECCENTRICITY_SQUARED)
    assert pole_m == pytest.approx(6_356_752.314245, abs=1e-5)
    up = enu_from_geodetic([[0.0, 0.0, 100.0]], [0.0, 0.0, 0.0])[0]
    assert up == pytest.approx([0.0, 0.0, 100.0], abs=1e-6)
    # From 0 N 0 E the point 0 N 90 E lies one radius to the east and one below.
    quarter = enu_from_geodetic([[90.0, 0.0, 0.0]], [0.0, 0.0, 0.0])[0]
    assert quarter == pytest.approx([SEMI_MAJOR_AXIS_M, 0.0, -SEMI_MAJOR_AXIS_M], abs=1e-6)
    pole = enu_from_geodetic([[0.0, 90.0, 7.0]], [0.0, 0.0, 0.0])[0]
    assert pole == pytest.approx([0.0, pole_m + 7.0, -SEMI_MAJOR_AXIS_M], abs=1e-6)


@pytest.mark.parametrize(
    "origin", [(-2.978, 56.46, 12.0), (139.7, -33.0, 900.0), (10, 0, -40), (25, 88.9, 0)]
)
def test_enu_and_geodetic_are_inverse(origin):
    points = np.random.default_rng(7).uniform(-5000, 5000, (50, 3))
    back = enu_from_geodetic(geodetic_from_enu(points, origin), origin)
    assert np.abs(back - points).max() < 1e-6
    turn = enu_from_earth(origin[0], origin[1])
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_the_plane_of_two_dimensions_agrees_near_its_origin():
    origin = (8.54, 47.38)
    points = np.random.default_rng(8).uniform(-200, 200, (20, 2))
    flat = geodetic_from_enu(np.column_stack([points, np.zeros(20)]), (*origin, 0.0))[:, :2]
    apart_m = east_north_from_geodetic(flat, origin) - points
    assert np.abs(apart_m).max() < 1e-6
