"""The systematic error of a depth sensor, estimated from depths that are known from elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthResponseOptions:
    """How the response of a depth sensor is fitted."""

    min_points: int = limit(
        50,
        "A sensor's response is fitted to at least this number of known depths.",
        chosen="By hand: fewer don't determine four coefficients.",
    )
    coefficient_sigma: float = limit(
        0.03,
        "Standard deviation of the prior on each coefficient, around those of a sensor without error.",
        chosen="By hand: sensors have a systematic error of a few per cent.",
    )
    sensor_sigma_ratio: float = limit(
        0.008,
        "Standard deviation of a corrected depth, relative to the depth.",
        chosen="By hand: about one per cent remains after the correction.",
    )
    loss_scale_sigmas: float = limit(
        2.0,
        "Error, in standard deviations, at which a depth's weight falls to half (Cauchy loss).",
        chosen="By hand: at the edge of an object the sensor may measure the surface behind it.",
    )
    low_quantile: float = limit(
        0.05,
        "Quantile of the known depths below which the response is kept constant.",
        chosen="By hand: a linear response must not be extrapolated.",
    )
    high_quantile: float = limit(
        0.95,
        "Quantile of the known depths above which the response is kept constant.",
        chosen="By hand: a linear response must not be extrapolated.",
    )
    steps: int = limit(
        15,
        "Steps of the reweighted least-squares fit.",
        chosen="By hand: meant to be enough to converge.",
    )


OPTIONS = DepthResponseOptions()


@dataclass(frozen=True, slots=True)
class DepthResponse:
    """The measurement z' of a depth sensor where the depth is z: `z' / z = a + b z' + c x + d y`.

    `coefficients` are a, b, c, d; x, y are on the image plane; z' is in metres, clipped to `range_m`. `b` is an
    offset of the disparity by which structured light and stereo measure depth (1 / z is linear in it); `c` and `d`
    are a tilt between depth camera and colour camera.
    """

    coefficients: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    range_m: tuple[float, float] = (0.0, np.inf)

    def correct(self, shown_m: Array, image_plane: Array) -> Array:
        """Return the corrected depths (n,) in metres of measured ones (n,) at image-plane positions (n, 2).

        A measurement of 0, no depth, stays 0.
        """
        return np.asarray(
            shown_m / (_terms(np.clip(shown_m, *self.range_m), image_plane) @ self.coefficients)
        )


def fit_depth_response(shown_m: Array, image_plane: Array, depth_m: Array, sigma: Array) -> DepthResponse:
    """Return the response of a sensor that measures `shown_m` (n,) where the depths are `depth_m` (n,), in metres.

    `image_plane` (n, 2) are the positions of the pixels, `sigma` (n,) the relative standard deviations of the known
    depths. Reweighted least squares with a Cauchy loss and a prior around a sensor without error. That sensor is the
    result for fewer than `OPTIONS.min_points` depths.
    """
    if len(shown_m) < OPTIONS.min_points:
        return DepthResponse()
    quantiles = np.quantile(shown_m, (OPTIONS.low_quantile, OPTIONS.high_quantile))
    low, high = (float(end) for end in quantiles)
    terms, ratio = _terms(shown_m, image_plane), shown_m / depth_m
    exact = np.array(DepthResponse().coefficients)
    found, prior = exact.copy(), np.eye(len(exact)) / OPTIONS.coefficient_sigma**2
    total = np.hypot(sigma, OPTIONS.sensor_sigma_ratio)
    for _ in range(OPTIONS.steps):
        errors = (ratio - terms @ found) / (OPTIONS.loss_scale_sigmas * total)
        weighted = terms * (1.0 / (1.0 + errors**2) / total**2)[:, None]
        found = np.linalg.solve(weighted.T @ terms + prior, weighted.T @ ratio + prior @ exact)
    a, b, c, d = (float(value) for value in found)
    return DepthResponse((a, b, c, d), (low, high))


def _terms(shown_m: Array, image_plane: Array) -> Array:
    return np.column_stack([np.ones(len(shown_m)), shown_m, image_plane])
