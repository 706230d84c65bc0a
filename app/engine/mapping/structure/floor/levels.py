"""The floor below a walk: how high it lies in each stretch, by the layer of points that is densest below the camera.

A floor is level, and a path that bends is not: where its scale slides by 5 percent, the floor comes 7 cm nearer to a
camera held at 1.5 m. The loops of a bent path agree with each other, so nothing else shows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.reconstruction import Reconstruction, median_depth
from app.geometry.triangulation import unit_rays
from app.limits import limit

Array = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorOptions:
    """When a layer of points below the camera is the floor."""

    pictures: int = limit(
        40,
        "Pictures of a stretch.",
        chosen="By hand: some metres of walking, a thousand points of the floor.",
    )
    stride: int = limit(20, "Pictures from one stretch to the next.", chosen="By hand: half of a stretch.")
    min_views: int = limit(3, "Views of a stretch that a point needs.", chosen="By hand: two don't check it.")
    min_points: int = limit(
        30, "Points of a stretch's floor.", chosen="By hand: each is exact to some percent of the height."
    )
    least_height: float = limit(
        0.3,
        "Least height of the camera above the floor, relative to the median depth of the features.",
        chosen="By hand: in a hall, where things are 5 m away, 1.5 m.",
    )
    most_height: float = limit(
        4.0,
        "Largest height of the camera above the floor, relative to the median depth of the features.",
        chosen="By hand: 1.5 m where most things are 40 cm away; with 2 the same floors are found on four paths.",
    )
    bandwidth: float = limit(
        0.012,
        "Standard deviation of the kernel by which the layer is found, of the height's logarithm.",
        chosen="By hand: 2 cm at 1.5 m, as the points scatter.",
    )
    step: float = limit(
        0.004,
        "Step of the heights that are tried, of the logarithm.",
        chosen="By hand: a third of the kernel.",
    )
    layer: float = limit(
        0.025,
        "Half the thickness of the layer, in heights of the camera.",
        chosen="By hand: twice the kernel.",
    )
    most_beside: float = limit(
        0.2,
        "Heights of the camera by which a stretch's floor may lie above or below that of the whole walk.",
        chosen="By hand, on the videos of `roomfix evaluate-video`: on right paths 0.04, on one bent by 20 cm 0.11 and "
        "where the camera turned in a corner 0.18; a stretch with another floor has steps or shows a table.",
    )
    most_below: float = limit(
        0.25,
        "Largest number of points below the layer, relative to those in it.",
        chosen="By hand: below a floor are mirrored or mistaken points, below a table its legs and the floor.",
    )
    most_above: float = limit(
        0.4,
        "Largest number of points in a layer as thick above it, relative to those in it.",
        chosen="By hand: the lowest strip of a wall has as many as the one above it.",
    )
    min_share: float = limit(
        0.6,
        "Least share of the stretches that show the floor.",
        chosen="By hand: where it is mostly out of view, it says little of the walk.",
    )
    max_unevenness: float = limit(
        0.08,
        "Most that the stretches of a level floor may differ in height, in heights of the camera.",
        chosen="By hand, on the videos of `roomfix evaluate-video`: at most 0.04 on a floor that is held, 0.15 on a "
        "path that was bent.",
    )
    max_unsteadiness: float = limit(
        0.03,
        "Most that the camera's height above a level floor may vary (80 percent of the stretches), relative to itself, "
        "where it counts as one height.",
        chosen="By hand, on the videos of `roomfix evaluate-video`: 0.02 to 0.04 on right paths, 0.06 to 0.08 on bent "
        "ones.",
    )
    unsteadiness_noise: float = limit(
        0.005, "Difference of two such numbers that says nothing.", chosen="By hand: the step of the heights."
    )
    plane_rounds: int = limit(
        3, "Times that the direction of up is found anew from the floor's points.", chosen="By hand."
    )
    max_tilt_deg: float = limit(
        3.0,
        "Largest angle by which the floor's points may turn the direction of up.",
        chosen="By hand: edges and sensors are off by a degree.",
    )


OPTIONS = FloorOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Floor:
    """A walk's floor: `up` (3,), how far along it the floor lies (`level`), and the camera's usual `height` above it.

    `points` (n,) are the rows of its points, `roughness` (n,) how far each lies above the floor of its own stretch. For
    each stretch `above` is how far its floor lies above that of the walk, and `held` how far its camera is above its
    floor, both in heights of the camera.
    """

    up: Array
    level: float
    height: float
    points: Rows
    roughness: Array
    above: Array
    held: Array

    @property
    def unevenness(self) -> float:
        """Return how far apart the highest and the lowest stretch of the floor are, in heights of the camera."""
        return float(np.ptp(self.above))

    @property
    def unsteadiness(self) -> float:
        """Return how much the camera's height above the floor varies over the walk, relative to itself."""
        low, high = np.quantile(self.held, [0.1, 0.9])
        return float(high - low)


@dataclass(frozen=True, slots=True)
class _Walk:
    """The cameras' places (n, 3) in order of time, the points (m, 3), and for each stretch its cameras and points."""

    places: Array
    points: Array
    stretches: list[tuple[slice, Rows]]


def find_floor(part: Reconstruction, down: tuple[float, float, float]) -> Floor | None:
    """Return the floor of a walk; None where too few of its stretches show one. `down` may be some degrees off."""
    depth = median_depth(part)
    walk = _walk(part)
    floor: Floor | None = None
    up = -np.asarray(down, dtype=np.float64)
    for left in reversed(range(OPTIONS.plane_rounds)):
        floor = _level_floor(walk, up, depth, is_exact=left == 0)
        if floor is None:
            return None
        up = _normal(part.points[floor.points], up)
    return floor


def is_steady(floor: Floor | None) -> bool:
    """Return whether a walk shows a level floor, and its camera is held at about one height above it."""
    return _is_level(floor) and floor.unsteadiness <= OPTIONS.max_unsteadiness


def is_better(floor: Floor | None, other: Floor) -> bool:
    """Return whether a walk shows a level floor, with the camera at one height above it, as well as another form of it.

    Levelling a floor that has a step changes the scale there, so that the camera seems to rise or to sink.
    """
    return _is_level(floor) and floor.unsteadiness <= other.unsteadiness + OPTIONS.unsteadiness_noise


def _is_level(floor: Floor | None) -> TypeGuard[Floor]:
    return floor is not None and floor.unevenness <= OPTIONS.max_unevenness


def _walk(part: Reconstruction) -> _Walk:
    rows = np.array(sorted(part.poses))
    seen = part.observations[np.argsort(part.observations[:, 0], kind="stable")]
    stretches = []
    for start in range(0, max(1, len(rows) - OPTIONS.stride), OPTIONS.stride):
        own = slice(start, min(start + OPTIONS.pictures, len(rows)))
        a, b = np.searchsorted(seen[:, 0], [rows[own.start], rows[own.stop - 1] + 1])
        numbers, views = np.unique(seen[a:b, 2], return_counts=True)
        stretches.append((own, numbers[views >= OPTIONS.min_views]))
    return _Walk(np.array([part.poses[row].translation for row in rows]), part.points, stretches)


def _level_floor(walk: _Walk, up: Array, depth: float, *, is_exact: bool) -> Floor | None:
    """Return the floor with a known direction of up; where this is not exact yet, its layers are blurred."""
    cameras, heights = walk.places @ up, walk.points @ up
    below = [float(np.median(cameras[own])) - heights[numbers] for own, numbers in walk.stretches]
    usual = _layer(np.concatenate(below), OPTIONS.least_height * depth, OPTIONS.most_height * depth)
    if usual is None:
        return None
    levels, held, rows, rough = list[float](), list[float](), list[Rows](), list[Array]()
    for (own, numbers), drop in zip(walk.stretches, below, strict=True):
        inside = _on_floor(drop, usual, is_exact=is_exact)
        if inside is None:
            continue
        middle = float(np.median(drop[inside]))
        held.append(middle)
        levels.append(float(np.median(cameras[own])) - middle)
        rows.append(numbers[inside])
        rough.append(middle - drop[inside])
    if len(levels) < OPTIONS.min_share * len(walk.stretches):
        return None
    level = float(np.median(levels))
    # A point of two stretches counts with its mean roughness in both.
    points, which, counts = np.unique(np.concatenate(rows), return_inverse=True, return_counts=True)
    return Floor(
        up=up,
        level=level,
        height=usual,
        points=points,
        roughness=np.bincount(which, np.concatenate(rough)) / counts,
        above=(np.array(levels) - level) / usual,
        held=np.array(held) / usual,
    )


def _on_floor(drop: Array, usual: float, *, is_exact: bool) -> NDArray[np.bool_] | None:
    """Return which points of a stretch, so far below the camera, are on its floor; None where it shows none."""
    height = _layer(drop, (1 - OPTIONS.most_beside) * usual, (1 + OPTIONS.most_beside) * usual)
    if height is None:
        return None
    inside: NDArray[np.bool_] = np.abs(drop - height) < OPTIONS.layer * usual
    count, reach = int(inside.sum()), OPTIONS.layer * usual
    beneath = np.count_nonzero(drop > height + 4 * reach)
    # As thick as the layer itself, just above what is still of the floor.
    higher = np.count_nonzero((drop < height - 2 * reach) & (drop > height - 4 * reach))
    is_layer = beneath <= OPTIONS.most_below * count and higher <= OPTIONS.most_above * count
    is_floor = count >= OPTIONS.min_points and (is_layer or not is_exact)
    return inside if is_floor else None


def _layer(drop: Array, lowest: float, highest: float) -> float | None:
    """Return how far below the camera most of the points (n,) lie, between two bounds; None without any."""
    inside = np.log(drop[(drop > lowest) & (drop < highest)])
    if not len(inside):
        return None
    steps = np.arange(np.log(lowest), np.log(highest) + OPTIONS.step, OPTIONS.step)
    counts, _ = np.histogram(inside, bins=np.append(steps, steps[-1] + OPTIONS.step))
    reach = int(np.ceil(4 * OPTIONS.bandwidth / OPTIONS.step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * OPTIONS.step / OPTIONS.bandwidth) ** 2)
    return float(np.exp(steps[np.convolve(counts, kernel, mode="same").argmax()] + OPTIONS.step / 2))


def _normal(points: Array, up: Array) -> Array:
    """Return the direction across the plane of points (n, 3), turned from `up` by no more than the limit."""
    centred = points - np.median(points, axis=0)
    normal: Array = np.linalg.svd(centred, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ up)
    is_near = normal @ up >= np.cos(np.radians(OPTIONS.max_tilt_deg))
    return normal if is_near else unit_rays(up[None])[0]
