"""The fit of matches over pose difference: exact on its own model, unmoved by outliers, held inside the data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.errors import DegenerateGeometryError
from app.vision.keyframes import ATTITUDE_CURVE, POSITION_CURVE, PowerLaw, thresholds_for_matches
from app.vision.power_law import crossing, fit_near, fit_power_law, rmse, threshold_within


def scattered(curve: PowerLaw, count: int = 300, outliers: float = 0.15, seed: int = 3):
    """Return differences and counts of a curve with 15 % scatter, some pairs seeing something else."""
    rng = np.random.default_rng(seed)
    x = np.exp(rng.uniform(np.log(0.02), np.log(1.0), count))
    matches = np.rint(curve(x) * np.exp(rng.normal(0, 0.15, count)))
    matches[rng.random(count) < outliers] = rng.integers(0, 5)
    return x, matches


def test_the_papers_thresholds_are_those_of_its_curves() -> None:
    thresholds = thresholds_for_matches(50)
    assert thresholds.position_m == pytest.approx(0.1757, abs=5e-5)
    assert thresholds.attitude_rad == pytest.approx(0.1304, abs=5e-5)
    for curve, expected in ((POSITION_CURVE, 0.1757), (ATTITUDE_CURVE, 0.1304)):
        found = threshold_within(curve, 50, 0.01, 1.0)
        assert (round(found.value, 4), found.reached) == (expected, "within")


@settings(max_examples=40, deadline=None)
@given(a=st.floats(1.0, 200.0), b=st.floats(-3.0, -0.05))
def test_counts_of_a_curve_give_the_curve(a: float, b: float) -> None:
    x = np.geomspace(0.02, 0.9, 40)
    # Scaled so that every count is above one, below which logarithms end.
    matches = (a + 500.0) * x**b
    fit = fit_power_law(x, matches)
    assert fit.a == pytest.approx(a + 500.0, rel=1e-4)
    assert fit.b == pytest.approx(b, abs=1e-4)
    assert rmse(fit, x, matches) == pytest.approx(0.0, abs=1e-2 * matches.max())


@pytest.mark.parametrize("truth", [POSITION_CURVE, ATTITUDE_CURVE])
def test_outliers_hardly_move_the_curve(truth: PowerLaw) -> None:
    x, matches = scattered(truth)
    robust = fit_power_law(x, matches)
    assert robust.b == pytest.approx(truth.b, abs=0.1)
    assert robust.a == pytest.approx(truth.a, rel=0.15)
    assert robust.inverse(50) == pytest.approx(truth.inverse(50), rel=0.12)


@pytest.mark.parametrize("seed", range(4))
def test_the_threshold_holds_where_counts_level_off_and_break_down(seed: int) -> None:
    """Real counts: a plateau, then a cliff; at 0.4 half of the pairs have 50."""
    rng = np.random.default_rng(seed)
    x = np.exp(rng.uniform(np.log(0.01), np.log(4.0), 600))
    smooth = 200.0 / (1.0 + 3.0 * (x / 0.4) ** 2)
    matches = np.rint(smooth * np.exp(rng.normal(0, 0.3, len(x))))
    local = fit_near(x, matches, 50)
    assert crossing(x, matches, 50) == pytest.approx(0.4, rel=0.25)
    assert local.curve.inverse(50) == pytest.approx(0.4, rel=0.2)
    squares = np.polyfit(np.log(x), np.log(np.maximum(matches, 1)), 1)
    assert abs(np.log(local.curve.inverse(50) / 0.4)) < abs(
        (np.log(50) - squares[1]) / squares[0] - np.log(0.4)
    )
    assert local.low < 0.4 < local.high
    assert local.high / local.low <= 9.5


def test_a_threshold_is_never_outside_the_data() -> None:
    curve = PowerLaw(10.0, -1.0)
    assert threshold_within(curve, 50, 0.1, 1.0).value == pytest.approx(0.2)
    beyond, below = threshold_within(curve, 50, 0.01, 0.1), threshold_within(curve, 50, 0.3, 1.0)
    assert (beyond.value, beyond.reached) == (0.1, "beyond")
    assert (below.value, below.reached) == (0.3, "below")


def test_counts_that_rise_give_no_rising_curve() -> None:
    x = np.geomspace(0.1, 1.0, 20)
    assert fit_power_law(x, 100 * x).b < 0


def test_all_pairs_on_one_side_cross_at_an_end() -> None:
    x = np.geomspace(0.1, 1.0, 20)
    assert crossing(x, np.full(20, 100), 50) == pytest.approx(1.0)
    assert crossing(x, np.zeros(20), 50) == pytest.approx(0.1)


def test_one_difference_makes_no_curve() -> None:
    with pytest.raises(DegenerateGeometryError):
        fit_power_law([0.2, 0.2, 0.2], [10, 20, 30])
    with pytest.raises(ValueError, match="above 0"):
        fit_power_law([0.0, 0.2], [10, 20])


def test_no_data_has_no_error() -> None:
    assert rmse(POSITION_CURVE, [], []) is None
