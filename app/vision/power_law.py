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
# Counts scatter by about this factor's logarithm around a curve; what is further off counts linearly.
SCATTER = 0.3
# Pairs whose counts are this many octaves from the wanted one weigh half.
OCTAVES_HALF_WEIGHT = 1.0
NEIGHBOURS = 15


@dataclass(frozen=True, slots=True)
class Threshold:
    """The difference at which a curve leaves the wanted matches, held inside the range of the data.

    `within`: the curve reaches the wanted number inside the range. `beyond`: more are left even at the largest
    difference, which is the value. `below`: fewer are left even at the smallest one, which is the value.
    """

    value: float
    reached: Reached


def fit_power_law(differences: ArrayLike, matches: ArrayLike, wanted: float | None = None) -> PowerLaw:
    """Return the robust fit of matches = a x^b, a > 0 > b, to differences (n,) above 0 and counts (n,).

    The residual is of the logarithms, with a soft-L1 loss: half a decade of counts weighs the same everywhere,
    and a pair with hardly a match, which looks at something else, doesn't pull. Least squares of the counts
    themselves fits the many matches of near pairs and is off by any factor where the few dozen of interest are.

    With `wanted`, pairs weigh by how near the median count of their neighbours in `differences` is to it: real
    counts level off at small differences, and the curve has to hold where it is read (A eq. 3).

    Raises `DegenerateGeometryError` for fewer than two different differences.
    """
    x = np.asarray(differences, dtype=np.float64)
    y = np.log(np.maximum(np.asarray(matches, dtype=np.float64), 1.0))
    if len(x) != len(y) or not np.all(x > 0):
        raise ValueError("fit_power_law takes as many differences above 0 as counts.")
    if len(np.unique(x)) < 2:
        raise DegenerateGeometryError("A curve needs pairs of frames at two different distances at least.")
    log_x = np.log(x)
    centre = float(np.mean(log_x))
    root_weights = np.ones(len(x)) if wanted is None else np.sqrt(_weights_near(x, y, wanted))

    def residuals(parameters: Array) -> Array:
        level, b = parameters
        return np.asarray(root_weights * (level + b * (log_x - centre) - y) / SCATTER)

    low, high = EXPONENT_BOUNDS
    fit = least_squares(
        residuals,
        x0=np.array([float(np.median(y)), -0.7]),
        bounds=(np.array([-np.inf, low]), np.array([np.inf, high])),
        loss="soft_l1",
    )
    level, b = (float(value) for value in fit.x)
    return PowerLaw(float(np.exp(level - b * centre)), b)


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


def _weights_near(x: Array, y: Array, wanted: float) -> Array:
    """Return weights (n,) that fall with the octaves between the running median of log counts y and `wanted`."""
    order = np.argsort(x, kind="stable")
    reach = min(NEIGHBOURS, max(1, len(x) // 5))
    sorted_y = y[order]
    medians = np.array(
        [np.median(sorted_y[max(0, i - reach) : i + reach + 1]) for i in range(len(x))], dtype=np.float64
    )
    octaves = (medians - np.log(wanted)) / np.log(2.0)
    weights = np.empty(len(x))
    weights[order] = 1.0 / (1.0 + (octaves / OCTAVES_HALF_WEIGHT) ** 2)
    return weights
