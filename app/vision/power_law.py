"""Fitting matches = a x^b to measured pairs of frames (A 2.1, eq. 1-3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from app.errors import DegenerateGeometryError
from app.vision.keyframes import PowerLaw

Array = NDArray[np.float64]
Reached = Literal["within", "beyond", "below"]

# Matches fall with the difference; a curve that rises is none.
EXPONENT_BOUNDS = (-12.0, -1e-3)
# Counts scatter by about a factor e^0.3 around a curve; what is further off counts linearly, not squared.
SCATTER = 0.3
# Real counts level off at small differences and fall off a cliff at large ones: a power law holds between the
# crossing divided by this and multiplied by this.
WINDOW = 3.0
MIN_IN_WINDOW = 12


@dataclass(frozen=True, slots=True)
class Threshold:
    """The difference at which a curve leaves the wanted matches, held inside the range of the data.

    `within`: the curve reaches the wanted number inside the range. `beyond`: more are left even at the largest
    difference, which is the value. `below`: fewer are left even at the smallest one, which is the value.
    """

    value: float
    reached: Reached


@dataclass(frozen=True, slots=True)
class LocalFit:
    """A curve and the differences [low, high] that it was fitted to."""

    curve: PowerLaw
    low: float
    high: float


def fit_power_law(differences: ArrayLike, matches: ArrayLike) -> PowerLaw:
    """Return the robust fit of matches = a x^b, a > 0 > b, to differences (n,) above 0 and counts (n,).

    The residual is of the logarithms, with a soft-L1 loss: a factor weighs the same everywhere, and a pair with
    hardly a match, which looks at something else, doesn't pull. Least squares of the counts themselves fits the
    many matches of near pairs and is off by any factor where the few dozen of interest are.

    Raises `DegenerateGeometryError` for fewer than two different differences.
    """
    x = np.asarray(differences, dtype=np.float64)
    y = np.log(np.maximum(np.asarray(matches, dtype=np.float64), 1.0))
    if len(x) != len(y) or not np.all(x > 0):
        raise ValueError("fit_power_law takes as many differences above 0 as counts.")
    if len(np.unique(x)) < 2:
        raise DegenerateGeometryError("A curve needs pairs of frames at two different distances at least.")
    log_x = np.log(x)
    # Around their mean the two parameters don't depend on each other.
    centre = float(np.mean(log_x))

    def residuals(parameters: Array) -> Array:
        level, b = parameters
        return np.asarray((level + b * (log_x - centre) - y) / SCATTER)

    low, high = EXPONENT_BOUNDS
    fit = least_squares(
        residuals,
        x0=np.array([float(np.median(y)), -0.7]),
        bounds=(np.array([-np.inf, low]), np.array([np.inf, high])),
        loss="soft_l1",
    )
    level, b = (float(value) for value in fit.x)
    return PowerLaw(float(np.exp(level - b * centre)), b)


def crossing(differences: ArrayLike, matches: ArrayLike, wanted: float) -> float:
    """Return the difference that best parts the pairs with `wanted` matches or more from those with fewer.

    It needs no model and no bins: the number of pairs on the wrong side is the least. An end of the data when
    all are on one side.
    """
    order = np.argsort(np.asarray(differences, dtype=np.float64), kind="stable")
    x = np.asarray(differences, dtype=np.float64)[order]
    enough = np.asarray(matches)[order] >= wanted
    wrong_below = np.concatenate([[0], np.cumsum(~enough)])
    wrong_above = np.concatenate([np.cumsum(enough[::-1])[::-1], [0]])
    split = int(np.argmin(wrong_below + wrong_above))
    return float(np.sqrt(x[max(split - 1, 0)] * x[min(split, len(x) - 1)]))


def fit_near(differences: ArrayLike, matches: ArrayLike, wanted: float) -> LocalFit:
    """Return the fit to the pairs around the crossing of `wanted` matches, where the curve is read (A eq. 3).

    Where fewer than `MIN_IN_WINDOW` pairs are within a factor of `WINDOW`, the nearest ones are taken.
    Raises `DegenerateGeometryError` like `fit_power_law`.
    """
    x, y = np.asarray(differences, dtype=np.float64), np.asarray(matches, dtype=np.float64)
    off = np.abs(np.log(x / crossing(x, y, wanted)))
    reach = max(float(np.log(WINDOW)), float(np.sort(off)[min(MIN_IN_WINDOW, len(x)) - 1]))
    near = off <= reach
    return LocalFit(fit_power_law(x[near], y[near]), float(x[near].min()), float(x[near].max()))


def rmse(curve: PowerLaw, differences: ArrayLike, matches: ArrayLike) -> float | None:
    """Return the root mean square error of a curve in matches; None without data."""
    counts = np.asarray(matches, dtype=np.float64)
    if counts.size == 0:
        return None
    return float(np.sqrt(np.mean((curve(differences) - counts) ** 2)))


def threshold_within(curve: PowerLaw, wanted: float, low: float, high: float) -> Threshold:
    """Return where the curve leaves `wanted` matches (A eq. 3), not outside the data's range [low, high]."""
    if float(curve(high)) > wanted:
        return Threshold(high, "beyond")
    if float(curve(low)) < wanted:
        return Threshold(low, "below")
    return Threshold(curve.inverse(wanted), "within")
