import numpy as np
import pytest

from app.geometry.geodesy import SEMI_MAJOR_AXIS_M, east_north_from_geodetic, geodetic_from_east_north


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
