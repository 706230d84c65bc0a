"""The direction of down in a picture, by the vertical edges of doors, walls and shelves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.errors import InvalidInputError
from app.geometry.triangulation import homogeneous, unit_rays
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class VerticalOptions:
    """Which edges vote for the vertical, and how it is refined."""

    max_tilt_deg: float = limit(
        45.0,
        "Largest angle between the image's y axis and the vertical.",
        chosen="By hand: cameras are mounted or held nearer to upright.",
    )
    max_edge_error_deg: float = limit(
        1.0,
        "Largest angle between a vertical edge and the line from its middle to the vertical's vanishing point.",
        chosen="By hand: the error of a detected edge's direction.",
    )
    max_edges: int = limit(
        200,
        "Longest edges that are used.",
        chosen="By hand: bounds the time; short edges have less exact directions.",
    )
    pairs: int = limit(
        400,
        "Random pairs of edges whose common vanishing points are compared.",
        chosen="By hand: many more than are needed to draw two vertical edges.",
    )
    steps: int = limit(
        8,
        "Steps of the reweighted least-squares fit.",
        chosen="By hand: meant to be enough to converge.",
    )
    min_crossing_sine: float = limit(
        0.05,
        "Least sine of the angle between the planes of two edges that determine a vanishing point.",
        chosen="By hand: nearly parallel planes have an uncertain common direction.",
    )
    min_edges: int = limit(
        3,
        "A vertical needs at least this number of steep edges.",
        chosen="By hand: any two edges have a common vanishing point; a third one confirms it.",
    )


OPTIONS = VerticalOptions()
MAX_TILT_RAD = float(np.radians(OPTIONS.max_tilt_deg))
MAX_EDGE_ERROR_SINE = float(np.sin(np.radians(OPTIONS.max_edge_error_deg)))


@dataclass(frozen=True, slots=True)
class VerticalDirection:
    """Down in camera axes (3,), the number of edges that agree, and their share of the length of all steep edges."""

    down: Array
    edges: int
    share: float


def vertical_direction(
    starts: ArrayLike, ends: ArrayLike, lengths: ArrayLike, *, max_edges: int = OPTIONS.max_edges
) -> VerticalDirection | None:
    """Return the vertical that most straight edges agree on, or None when there is none within 45 degrees of image y.

    Edges run from `starts` (n, 2) to `ends` (n, 2), in image-plane coordinates, and are weighted by `lengths` (n,); the
    `max_edges` longest steep ones are used. Random pairs of edges give candidates of the vanishing point; the one with
    the largest weight of edges is refined by least squares. None also when fewer than `OPTIONS.min_edges` edges are
    steep. Raises `InvalidInputError` for arrays of different lengths. Source: the planes through edges and the camera
    of Barnard, "Interpreting perspective images", 1983.
    """
    a, b = homogeneous(starts), homogeneous(ends)
    weights = np.asarray(lengths, dtype=np.float64)
    if not len(a) == len(b) == len(weights):
        raise InvalidInputError("Each edge needs a start, an end and a length.")
    normals = np.cross(a, b)
    sines = np.linalg.norm(normals, axis=1)
    steep = np.flatnonzero(np.abs(normals[:, 1]) < np.sin(MAX_TILT_RAD) * sines)
    chosen = steep[np.argsort(-weights[steep])[:max_edges]]
    if len(chosen) < OPTIONS.min_edges:
        return None
    edges = _Edges(
        normals[chosen] / sines[chosen, None],
        unit_rays(a[chosen] + b[chosen]),
        weights[chosen] / weights[chosen].sum(),
    )
    down = edges.best_crossing()
    if down is None:
        return None
    for _ in range(OPTIONS.steps):
        down = edges.fitted(down)
    # The fit may have moved to another vanishing point, such as that of floorboards.
    if down[1] < np.cos(MAX_TILT_RAD):
        return None
    near = edges.errors(down[None])[0] < MAX_EDGE_ERROR_SINE
    return VerticalDirection(down, int(near.sum()), float(edges.weights[near].sum()))


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edges: the unit normals (n, 3) of their planes through the camera centre, the unit rays (n, 3) of their middles,
    and their weights (n,)."""

    normals: Array
    middles: Array
    weights: Array

    def errors(self, directions: Array) -> Array:
        """Return the sines (k, n) of the angles between edges and the lines from their middles to vanishing points.

        `directions` (k, 3) are those of the vanishing points, of unit length.
        """
        across = np.sqrt(np.maximum(1.0 - (directions @ self.middles.T) ** 2, 1e-12))
        return np.asarray(np.abs(directions @ self.normals.T) / across)

    def best_crossing(self) -> Array | None:
        """Return the common direction (3,) of two edges that has most support, or None when no two have one."""
        rng = np.random.default_rng(0)
        first, second = (rng.choice(len(self.weights), OPTIONS.pairs, p=self.weights) for _ in range(2))
        crossings = np.cross(self.normals[first], self.normals[second])
        sines = np.linalg.norm(crossings, axis=1)
        firm = sines > OPTIONS.min_crossing_sine
        crossings = crossings[firm] / sines[firm, None]
        crossings *= np.where(crossings[:, 1:2] < 0, -1.0, 1.0)
        crossings = crossings[crossings[:, 1] > np.cos(MAX_TILT_RAD)]
        if not len(crossings):
            return None
        votes = np.maximum(0.0, 1.0 - (self.errors(crossings) / MAX_EDGE_ERROR_SINE) ** 2) @ self.weights
        return np.asarray(crossings[int(np.argmax(votes))])

    def fitted(self, down: Array) -> Array:
        """Return the direction (3,) after one reweighted least-squares step from a direction (3,)."""
        errors = self.errors(down[None])[0]
        weights = self.weights * np.maximum(0.0, 1.0 - (errors / MAX_EDGE_ERROR_SINE) ** 2) ** 2
        # The unknowns are small rotations of `down`: an unrestricted fit could move far along the edges.
        axes = np.linalg.svd(down[None])[2][1:]
        rows, residuals = self.normals @ axes.T, self.normals @ down
        hessian = (rows * weights[:, None]).T @ rows
        step = -np.linalg.solve(hessian + 1e-9 * np.eye(2), (rows * weights[:, None]).T @ residuals)
        return np.asarray(unit_rays((down + step @ axes)[None])[0])
