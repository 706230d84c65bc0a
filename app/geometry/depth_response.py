"""What a depth sensor shows instead of the depth, found from depths that are known otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Fewer known depths say nothing about the sensor.
MIN_POINTS = 50
# Sensors are right to a few per cent (one sigma of each coefficient), and to a per cent after correction.
COEFFICIENT_SIGMA = 0.03
SENSOR_SIGMA = 0.008
# A depth's say falls to half where it is off by so many sigmas: at the edge of an object the sensor shows another one.
LOSS_SCALE = 2.0
# Beyond the depths that nearly all known ones are between, the response is taken to stay as it is there.
RANGE_QUANTILES = (0.05, 0.95)


@dataclass(frozen=True, slots=True)
class DepthResponse:
    """A sensor that shows z' where the depth is z: `z' / z = a + b z' + c x + d y`.

    `coefficients` are a, b, c, d; x, y are on the image plane, z' is in metres and held at the ends of `range_m`.
    `b` is an offset of the disparity, from which structured light and stereo get the depth (1 / z is linear in it);
    `c`, `d` are a tilt of the depth camera against the colour camera.
    """

    coefficients: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    range_m: tuple[float, float] = (0.0, np.inf)

    def correct(self, shown_m: Array, image_plane: Array) -> Array:
        """Return the depths (n,) in metres at image-plane positions (n, 2) where the sensor shows `shown_m` (n,); 0,
        no depth, stays 0."""
        return np.asarray(
            shown_m / (_terms(np.clip(shown_m, *self.range_m), image_plane) @ self.coefficients)
        )


def fit_depth_response(shown_m: Array, image_plane: Array, depth_m: Array, sigma: Array) -> DepthResponse:
    """Return the response of a sensor that shows `shown_m` (n,) at image-plane positions (n, 2) where the depths are
    `depth_m` (n,), known to within the share `sigma` (n,) of them.

    Least squares with a Cauchy loss, reweighted; the coefficients are pulled to those of a sensor that is right, which
    it is taken to be when fewer than `MIN_POINTS` depths are known.
    """
    if len(shown_m) < MIN_POINTS:
        return DepthResponse()
    low, high = (float(end) for end in np.quantile(shown_m, RANGE_QUANTILES))
    terms, ratio = _terms(shown_m, image_plane), shown_m / depth_m
    right = np.array(DepthResponse().coefficients)
    found, prior = right.copy(), np.eye(len(right)) / COEFFICIENT_SIGMA**2
    total = np.hypot(sigma, SENSOR_SIGMA)
    for _ in range(15):
        weights = 1.0 / (1.0 + ((ratio - terms @ found) / (LOSS_SCALE * total)) ** 2) / total**2
        weighted = terms * weights[:, None]
        found = np.linalg.solve(weighted.T @ terms + prior, weighted.T @ ratio + prior @ right)
    a, b, c, d = (float(value) for value in found)
    return DepthResponse((a, b, c, d), (low, high))


def _terms(shown_m: Array, image_plane: Array) -> Array:
    return np.column_stack([np.ones(len(shown_m)), shown_m, image_plane])
