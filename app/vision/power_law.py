"""Fit of matches = a x^b to measured pairs of frames (A 2.1, eq. 1-3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from app.errors import DegenerateGeometryError
from app.limits import limit
from app.vision.keyframes import PowerLaw

Array = NDArray[np.float64]
Reached = Literal["within", "beyond", "below"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerLawOptions:
    """How a curve is fitted."""

    min_exponent: float = limit(
        -12.0,
        "Least exponent of a curve.",
        chosen="By hand: far below those of real scans (docs/calibration.md).",
    )
    max_exponent: float = limit(
        -1e-3,
        "Largest exponent of a curve.",
        chosen="By hand: the number of matches decreases with the difference.",
    )
    start_exponent: float = limit(
        -0.7,
        "Exponent from which the fit starts.",
        chosen="By hand: between the exponents of the RGB-D database paper, -0.54 and -0.85.",
    )
    scatter_log: float = limit(
        0.3,
        "Scale of the soft-L1 loss of a count's logarithm: beyond it the loss grows only linearly.",
        chosen="By hand: counts usually differ from a curve by a factor of about e^0.3.",
    )
    window_ratio: float = limit(
        3.0,
        "A curve is fitted to the differences within this factor of the crossing.",
        chosen="By hand: further away real counts don't follow a power law (docs/calibration.md, Fit).",
    )
    min_window_pairs: int = limit(
        12,
        "Least number of pairs of frames that a curve is fitted to.",
        chosen="By hand: enough for two parameters and some outliers.",
    )


OPTIONS = PowerLawOptions()


@dataclass(frozen=True, slots=True)
class Threshold:
    """The difference at which a curve has the wanted number of matches, inside the range of the data.

    `reached` is `within` when the curve has that number inside the range. It is `beyond` when the curve has more even
    at the largest difference, and `below` when it has fewer even at the smallest; the value is then that difference.
    """

    value: float
    reached: Reached


@dataclass(frozen=True, slots=True)
class LocalFit:
    """A curve and the range [low, high] of the differences that it was fitted to."""

    curve: PowerLaw
    low: float
    high: float


def fit_power_law(differences: ArrayLike, matches: ArrayLike) -> PowerLaw:
    """Return the robust fit of matches = a x^b, a > 0 > b, to differences (n,) above 0 and counts (n,).

    The residuals are differences of logarithms, with a soft-L1 loss: a factor has the same weight everywhere, and a
    pair with hardly any match, whose frames show different things, has little influence. Least squares on the counts
    would fit the many matches of near pairs, and may be wrong by any factor around the few dozen of interest.

    Raises `DegenerateGeometryError` for fewer than two different differences.
    """
    x = np.asarray(differences, dtype=np.float64)
    y = np.log(np.maximum(np.asarray(matches, dtype=np.float64), 1.0))
    if len(x) != len(y) or not np.all(x > 0):
        raise ValueError("fit_power_law takes as many differences above 0 as counts.")
    if len(np.unique(x)) < 2:
        raise DegenerateGeometryError("A curve needs pairs of frames at two different distances at least.")
    log_x = np.log(x)
    # With differences relative to their mean the two parameters are not correlated.
    centre = float(np.mean(log_x))

    def residuals(parameters: Array) -> Array:
        level, b = parameters
        return np.asarray((level + b * (log_x - centre) - y) / OPTIONS.scatter_log)

    fit = least_squares(
        residuals,
        x0=np.array([float(np.median(y)), OPTIONS.start_exponent]),
        bounds=(np.array([-np.inf, OPTIONS.min_exponent]), np.array([np.inf, OPTIONS.max_exponent])),
        loss="soft_l1",
    )
    level, b = (float(value) for value in fit.x)
    return PowerLaw(float(np.exp(level - b * centre)), b)


def crossing(differences: ArrayLike, matches: ArrayLike, wanted: float) -> float:
    """Return the difference that best separates the pairs with at least `wanted` matches from those with fewer.

    It has the fewest pairs on the wrong side, which needs no model and no bins. An end of the data when all pairs are
    on one side.
    """
    order = np.argsort(np.asarray(differences, dtype=np.float64), kind="stable")
    x = np.asarray(differences, dtype=np.float64)[order]
    enough = np.asarray(matches)[order] >= wanted
    wrong_below = np.concatenate([[0], np.cumsum(~enough)])
    wrong_above = np.concatenate([np.cumsum(enough[::-1])[::-1], [0]])
    split = int(np.argmin(wrong_below + wrong_above))
    return float(np.sqrt(x[max(split - 1, 0)] * x[min(split, len(x) - 1)]))


def fit_near(differences: ArrayLike, matches: ArrayLike, wanted: float) -> LocalFit:
    """Return the fit to the pairs around the crossing of `wanted` matches, where the curve is evaluated (A eq. 3).

    The pairs are those within a factor of `OPTIONS.window_ratio`, or the `OPTIONS.min_window_pairs` nearest ones if
    these are more. Raises `DegenerateGeometryError` like `fit_power_law`.
    """
    x, y = np.asarray(differences, dtype=np.float64), np.asarray(matches, dtype=np.float64)
    distances = np.abs(np.log(x / crossing(x, y, wanted)))
    nearest = float(np.sort(distances)[min(OPTIONS.min_window_pairs, len(x)) - 1])
    near = distances <= max(float(np.log(OPTIONS.window_ratio)), nearest)
    return LocalFit(fit_power_law(x[near], y[near]), float(x[near].min()), float(x[near].max()))


def rmse(curve: PowerLaw, differences: ArrayLike, matches: ArrayLike) -> float | None:
    """Return the root mean square error of a curve, in matches; None without data."""
    counts = np.asarray(matches, dtype=np.float64)
    if counts.size == 0:
        return None
    return float(np.sqrt(np.mean((curve(differences) - counts) ** 2)))


def threshold_within(curve: PowerLaw, wanted: float, low: float, high: float) -> Threshold:
    """Return the difference at which the curve has `wanted` matches (A eq. 3), within the data's range [low, high]."""
    if float(curve(high)) > wanted:
        return Threshold(high, "beyond")
    if float(curve(low)) < wanted:
        return Threshold(low, "below")
    return Threshold(curve.inverse(wanted), "within")
