"""Which way is down in a picture, by the vertical edges of doors, walls and shelves in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidInputError
from app.geometry.triangulation import homogeneous, unit_rays

Array = NDArray[np.float64]

# A camera is mounted, or held, within so much of upright: other edges aren't taken for vertical ones.
MAX_TILT_RAD = float(np.radians(45.0))
# An edge points at the vertical's vanishing point within this.
MAX_ERROR = float(np.sin(np.radians(1.0)))
LONGEST, PAIRS, ROUNDS = 200, 400, 8
# Two edges closer to parallel to each other than this, as planes through the camera, have no firm common direction.
MIN_SINE = 0.05


@dataclass(frozen=True, slots=True)
class VerticalDirection:
    """Down in camera axes, (3,), the number of edges that point at it, and their share of the length of all edges that
    might."""

    down: Array
    edges: int
    share: float


def vertical_direction(starts: ArrayLike, ends: ArrayLike, lengths: ArrayLike) -> VerticalDirection | None:
    """Return where most straight edges point, weighted by `lengths` (n,), or None when fewer than three are steep.

    They run from `starts` (n, 2) to `ends` (n, 2), in image-plane coordinates. Random pairs of edges cross at vanishing
    points; the best supported one within 45 degrees of the image's lower side is refined by least squares. Raises
    `InvalidInputError` for arrays of different lengths. Source: the planes through edges and the camera of Barnard,
    "Interpreting perspective images", 1983.
    """
    a, b = homogeneous(starts), homogeneous(ends)
    weights = np.asarray(lengths, dtype=np.float64)
    if not len(a) == len(b) == len(weights):
        raise InvalidInputError("Each edge needs a start, an end and a length.")
    normals = np.cross(a, b)
    sines = np.linalg.norm(normals, axis=1)
    steep = np.flatnonzero(np.abs(normals[:, 1]) < np.sin(MAX_TILT_RAD) * sines)
    chosen = steep[np.argsort(-weights[steep])[:LONGEST]]
    if len(chosen) < 3:
        return None
    edges = _Edges(
        normals[chosen] / sines[chosen, None],
        unit_rays(a[chosen] + b[chosen]),
        weights[chosen] / weights[chosen].sum(),
    )
    down = edges.best_crossing()
    if down is None:
        return None
    for _ in range(ROUNDS):
        down = edges.fitted(down)
    # Floorboards that run away from a camera that looks down vanish above the picture.
    if down[1] < np.cos(MAX_TILT_RAD):
        return None
    near = edges.errors(down[None])[0] < MAX_ERROR
    return VerticalDirection(down, int(near.sum()), float(edges.weights[near].sum()))


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edges by the unit normals (n, 3) of their planes through the camera, their middles' unit rays (n, 3), weights."""

    normals: Array
    middles: Array
    weights: Array

    def errors(self, directions: Array) -> Array:
        """Return the sine (k, n) of the angle between each edge and the line from its middle to where each of some
        directions (k, 3) vanishes."""
        across = np.sqrt(np.maximum(1.0 - (directions @ self.middles.T) ** 2, 1e-12))
        return np.asarray(np.abs(directions @ self.normals.T) / across)

    def best_crossing(self) -> Array | None:
        """Return the best supported direction (3,) in which two edges agree, or None when no two do."""
        rng = np.random.default_rng(0)
        first, second = (rng.choice(len(self.weights), PAIRS, p=self.weights) for _ in range(2))
        crossings = np.cross(self.normals[first], self.normals[second])
        sines = np.linalg.norm(crossings, axis=1)
        crossings = crossings[sines > MIN_SINE] / sines[sines > MIN_SINE, None]
        crossings *= np.where(crossings[:, 1:2] < 0, -1.0, 1.0)
        crossings = crossings[crossings[:, 1] > np.cos(MAX_TILT_RAD)]
        if not len(crossings):
            return None
        votes = np.maximum(0.0, 1.0 - (self.errors(crossings) / MAX_ERROR) ** 2) @ self.weights
        return np.asarray(crossings[int(np.argmax(votes))])

    def fitted(self, down: Array) -> Array:
        """Return the direction (3,) that the edges near a direction (3,) agree on best."""
        errors = self.errors(down[None])[0]
        weights = self.weights * np.maximum(0.0, 1.0 - (errors / MAX_ERROR) ** 2) ** 2
        # Small turns in the plane across `down`: far along the edges the fit would else slide to where few lie.
        axes = np.linalg.svd(down[None])[2][1:]
        rows, residuals = self.normals @ axes.T, self.normals @ down
        hessian = (rows * weights[:, None]).T @ rows
        step = -np.linalg.solve(hessian + 1e-9 * np.eye(2), (rows * weights[:, None]).T @ residuals)
        return np.asarray(unit_rays((down + step @ axes)[None])[0])
