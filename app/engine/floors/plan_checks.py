"""Checks of how a plan is said to lie in the world, before it is believed.

A survey leaves residuals of decimetres and a scale near 1. What is far from that is an error of the input. The usual
errors can be named, since the points fit once the error is undone: pixels or other units instead of metres, y pointing
down, a world whose vertical axis is not z, a stretched drawing, one wrong pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.plan_units import describe_scale, is_other_unit, is_true_to_size
from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.alignment import fit_affine_2d
from app.geometry.plan import PlanFit, fit_plan_from_world
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanCheckOptions:
    """Which residuals a survey leaves, and when another reading of the points explains them.

    A relative residual is the root mean square residual divided by the root mean square distance of the points from
    their mean.
    """

    max_residual_ratio: float = limit(
        0.1,
        "Largest relative residual.",
        chosen="By hand: points picked on a plan and in a map give a few hundredths, mirrored points up to 1.",
    )
    picking_error_m: float = limit(
        0.5,
        "A residual or an error of size up to this is accepted in a venue of any size.",
        chosen="By hand: somewhat more than the error with which people pick points on a plan.",
    )
    doubt_ratio: float = limit(
        0.03,
        "From this relative residual on, another reading that fits far better is believed.",
        chosen="By hand: mirrored points of a long corridor give only a few hundredths.",
    )
    min_doubt_m: float = limit(
        0.1, "No doubt below this residual.", chosen="By hand: a good survey of a small room leaves as much."
    )
    far_better_ratio: float = limit(
        0.2,
        "Another reading fits far better when its residual is at most this part of the residual as given.",
        chosen="By hand: a wrong reading of right points comes that close only when they are almost on a line.",
    )
    better_ratio: float = limit(
        0.5,
        "The same for points that don't fit as given, so that only the cause is in question.",
        chosen="By hand: half the residual is no chance when both readings have the same points.",
    )
    min_stretch_ratio: float = limit(
        1.05,
        "Ratio of the scales along x and y from which a drawing is called stretched.",
        chosen="By hand: the ratio of a printed and scanned drawing is below 1.02.",
    )
    max_skew: float = limit(
        0.05,
        "Largest cosine of the angle between the axes of a drawing that is only stretched.",
        chosen="By hand: stretching keeps the axes of the drawing perpendicular.",
    )
    min_metres_per_degree: float = limit(
        10_000.0,
        "Points are degrees only when so many metres of the others are one unit of theirs, or more.",
        chosen="By hand: a degree of latitude is 111 km, one of longitude 10 km at 85 degrees north.",
    )
    min_degrees: float = limit(
        0.1,
        "Points that are all nearer than this to 0 in both numbers are no degrees.",
        chosen="By hand: 11 km of the sea where the equator meets the first meridian.",
    )
    vertical_slack_m: float = limit(
        1.0,
        "Points of one floor may differ in height by the height of the floor and this much.",
        chosen="By hand: steps and galleries of one floor.",
    )
    close_scale_ratio: float = limit(
        1.03,
        "Two points show that another axis is vertical when the scale is within this factor of 1 only then.",
        chosen="By hand: a distance measured on a plan is about a hundredth off.",
    )


OPTIONS = PlanCheckOptions()
# The ground as seen from above, x to the right and y up, of worlds whose vertical axis is not z: the two columns, the
# sign of the second one, the name, and the vertical axis.
OTHER_AXES = (
    (0, 2, -1.0, "(x, -z)", 1),
    (0, 2, 1.0, "(x, z)", 1),
    (1, 2, 1.0, "(y, z)", 0),
    (1, 2, -1.0, "(y, -z)", 0),
)
ADVICE = (
    "Check that the pairs belong together, that plan points are metres with x right and y up, and that world points "
    "are from a map whose z axis points up."
)


@dataclass(frozen=True, slots=True)
class _Points:
    """Correspondences: world points (n, 2 or 3), plan points (n, 2), and the height of the floor, if known."""

    world: Array
    plan: Array
    height_m: float | None = None

    def __len__(self) -> int:
        return len(self.world)

    def fit_on_one_floor(self, axis: int) -> bool:
        """Return whether the points can be on one floor when an axis of the world is vertical."""
        if self.height_m is None:
            return True
        return float(np.ptp(self.world[:, axis])) <= self.height_m + OPTIONS.vertical_slack_m


@dataclass(frozen=True, slots=True)
class _Reading:
    """Points read in one way: what was changed, the cause that it would have, and the fit."""

    change: str
    cause: str
    fit: PlanFit
    spread_m: float

    @property
    def residual_m(self) -> float:
        """The root mean square residual in world or plan metres, whichever is the larger unit."""
        return self.fit.residual_rms_m / max(self.fit.scale, 1.0)

    @property
    def fits(self) -> bool:
        """Whether the residual is one that a survey leaves."""
        return self.residual_m <= max(OPTIONS.picking_error_m, OPTIONS.max_residual_ratio * self.spread_m)

    @property
    def is_doubtful(self) -> bool:
        """Whether the residual is large enough to ask for another reading."""
        return self.residual_m > max(OPTIONS.min_doubt_m, OPTIONS.doubt_ratio * self.spread_m)

    @property
    def is_true_to_size(self) -> bool:
        """Whether the scale can be that of metres, given the error of picked points."""
        error_m = abs(self.fit.scale - 1.0) * self.spread_m
        by_picking = error_m <= OPTIONS.picking_error_m and not is_other_unit(self.fit.scale)
        return is_true_to_size(self.fit.scale) or by_picking


def fit_checked(world: Array, plan: Array, height_m: float | None = None) -> PlanFit:
    """Return the `plan_from_world` fitted to world points (n, 2 or 3) and plan points (n, 2).

    `height_m` is the height of the floor, if known. Raises `InvalidInputError` that names the likely cause when the
    residuals or the scale are far from what a survey leaves, or the points have no fit.
    """
    points = _Points(world, plan, height_m)
    for name, own, other in (("plan", plan, world[:, :2]), ("world", world[:, :2], plan)):
        if _are_degrees(own, other):
            raise InvalidInputError(
                f"The {name} points look like longitude and latitude: all lie within {np.ptp(own, axis=0).max():.2g} "
                f"of each other, the other ones within {np.ptp(other, axis=0).max():.3g} m. Give metres."
            )
    try:
        given = _read("", "", world[:, :2], plan)
    except DegenerateGeometryError as error:
        raise InvalidInputError(f"{error} {_named_cause(points, float('inf')) or ''}".rstrip()) from None
    if len(points) == 2:
        _check_two(given, points)
    elif not given.fits:
        raise InvalidInputError(f"{_misfit(given)} {_cause_of_misfit(given, points)}")
    elif given.is_doubtful:
        cause = _named_cause(points, OPTIONS.far_better_ratio * given.residual_m)
        if cause is not None:
            raise InvalidInputError(f"{_misfit(given)} {cause}")
    if not given.is_true_to_size:
        turned = [one for one in _other_axes(points) if one.fits and one.is_true_to_size and len(points) > 2]
        cause = _remedy(turned[0]) if turned else describe_scale(given.fit.scale)
        raise InvalidInputError(
            f"The correspondences give {given.fit.scale:.4g} plan units for each metre of the world. {cause}"
        )
    return given.fit


def _are_degrees(points: Array, others: Array) -> bool:
    """Return whether points (n, 2) can be longitude and latitude of what others (n, 2) are in metres."""
    extent, other_m = float(np.ptp(points, axis=0).max()), float(np.ptp(others, axis=0).max())
    if not 0 < extent * OPTIONS.min_metres_per_degree <= other_m:
        return False
    # A drawing of that scale begins near (0, 0), which is in the sea.
    return bool((np.abs(points).max(axis=0) > OPTIONS.min_degrees).any() and (np.abs(points) <= 180.0).all())


def check_matrix(matrix: Array) -> None:
    """Raise `InvalidInputError` that names the likely cause for a `plan_from_world` that no plan in metres has.

    Other errors, as of a matrix that is not (4, 4) or can't be inverted, are left to `PlanTransform`.
    """
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return
    last = [0.0, 0.0, 0.0, 1.0]
    if not np.allclose(matrix[3], last, atol=1e-6) and np.allclose(matrix[:, 3], last, atol=1e-6):
        raise InvalidInputError(
            "plan_from_world is transposed: its shift stands in the last row and belongs into the last column."
        )
    linear = matrix[:3, :3]
    if abs(np.linalg.det(linear)) < 1e-12:
        return
    up = np.abs(linear[2]) / np.linalg.norm(linear[2])
    if up[:2].max() > 0.99:
        raise InvalidInputError(
            f"plan_from_world takes {'xy'[int(np.argmax(up))]} of the world as vertical, but z points up in the world. "
            "Build the map with gravity or world_from_scan, and give the matrix for that world."
        )
    sizes = np.linalg.svd(linear[:2, :2], compute_uv=False)
    if sizes[1] <= 0 or sizes[0] / sizes[1] > OPTIONS.min_stretch_ratio:
        return
    scale, mirrored = float(np.sqrt(sizes[0] * sizes[1])), bool(np.linalg.det(linear[:2, :2]) < 0)
    if not is_true_to_size(scale):
        cause = describe_scale(scale, mirrored)
        raise InvalidInputError(
            f"plan_from_world gives {scale:.4g} plan units for each metre of the world. {cause}"
        )


def _read(change: str, cause: str, ground: Array, plan: Array) -> _Reading:
    spread_m = float(np.sqrt(np.mean(np.sum((ground - ground.mean(axis=0)) ** 2, axis=1))))
    return _Reading(change, cause, fit_plan_from_world(ground, plan), spread_m)


def _misfit(given: _Reading) -> str:
    return (
        f"The correspondences contradict each other: the best fit leaves {given.residual_m:.2f} m (root mean square) "
        f"among points that are {given.spread_m:.2f} m from their middle."
    )


def _cause_of_misfit(given: _Reading, points: _Points) -> str:
    """Return the sentence of what is wrong with points that don't fit, or what to check."""
    cause = _named_cause(points, OPTIONS.better_ratio * given.residual_m)
    return cause or _stretch(given, points) or _wrong_pair(given, points) or ADVICE


def _named_cause(points: _Points, max_residual_m: float) -> str | None:
    """Return the sentence of the first other reading that fits with such a residual, None without one."""
    if len(points) == 2:
        return None
    for other in (*_mirrored(points), *_other_axes(points)):
        if other.fits and other.residual_m <= max_residual_m:
            return _remedy(other)
    return None


def _mirrored(points: _Points) -> Iterator[_Reading]:
    """Yield the points with y of the plan reversed."""
    try:
        yield _read("Mirrored", "is y of the plan up?", points.world[:, :2], points.plan * [1.0, -1.0])
    except DegenerateGeometryError:
        return


def _other_axes(points: _Points) -> Iterator[_Reading]:
    """Yield the points with another axis of the world as the vertical one, where that puts them on one floor."""
    if points.world.shape[1] < 3:
        return
    for first, second, sign, name, vertical in OTHER_AXES:
        if not points.fit_on_one_floor(vertical):
            continue
        ground = np.column_stack([points.world[:, first], sign * points.world[:, second]])
        change, axis = f"With {name} of the world as ground", "xy"[vertical]
        cause = (
            f"{axis} of the world is vertical, but z must be; build the map with gravity or world_from_scan."
        )
        try:
            yield _read(change, cause, ground, points.plan)
        except DegenerateGeometryError:
            continue


def _remedy(other: _Reading) -> str:
    scale = other.fit.scale
    at = "" if other.is_true_to_size else f" at {scale:.4g} plan units for each metre of the world"
    sentence = f"{other.change} they fit within {other.residual_m:.2f} m{at}: {other.cause}"
    if other.is_true_to_size:
        return sentence
    return f"{sentence} {describe_scale(scale, other.change == 'Mirrored')}"


def _stretch(given: _Reading, points: _Points) -> str | None:
    """Return the sentence for a drawing whose two axes have different scales."""
    if len(points) < 4:
        return None
    ground = points.world[:, :2]
    try:
        linear, shift = fit_affine_2d(ground, points.plan)
    except DegenerateGeometryError:
        return None
    along_x, along_y = np.linalg.norm(linear, axis=1)
    if min(along_x, along_y) <= 0 or np.linalg.det(linear) <= 0:
        return None
    skew = abs(float(linear[0] @ linear[1])) / (along_x * along_y)
    ratio = max(along_x, along_y) / min(along_x, along_y)
    rest_m = np.linalg.norm(ground @ linear.T + shift - points.plan, axis=1) / max(1.0, along_x, along_y)
    residual_m = float(np.sqrt(np.mean(rest_m**2)))
    if ratio < OPTIONS.min_stretch_ratio or skew > OPTIONS.max_skew:
        return None
    if residual_m > OPTIONS.better_ratio * given.residual_m:
        return None
    return (
        f"With scale {along_x:.3g} along x and {along_y:.3g} along y of the plan they fit within {residual_m:.2f} m: "
        "the drawing is stretched. Correct its aspect ratio."
    )


def _wrong_pair(given: _Reading, points: _Points) -> str | None:
    """Return the sentence for one pair without which the others fit, as of swapped or mistyped numbers."""
    if len(points) < 4:
        return None
    best: tuple[float, int] | None = None
    for index in range(len(points)):
        ground, plan = np.delete(points.world[:, :2], index, axis=0), np.delete(points.plan, index, axis=0)
        try:
            rest = _read("", "", ground, plan)
        except DegenerateGeometryError:
            continue
        if rest.fits and rest.is_true_to_size and (best is None or rest.residual_m < best[0]):
            best = rest.residual_m, index
    if best is None or best[0] > OPTIONS.better_ratio * given.residual_m:
        return None
    return f"Without correspondences[{best[1]}] the others fit within {best[0]:.2f} m: check that pair."


def _check_two(given: _Reading, points: _Points) -> None:
    """Raise when two points, which always fit, show by their distance that another axis than z is vertical."""
    if points.world.shape[1] < 3 or points.fit_on_one_floor(2) or _is_close(given.fit.scale):
        return
    for other in _other_axes(points):
        if _is_close(other.fit.scale):
            apart_m = float(np.ptp(points.world[:, 2]))
            raise InvalidInputError(
                f"The two world points differ in z by {apart_m:.3g} m, more than the floor is high. {_remedy(other)}"
            )


def _is_close(scale: float) -> bool:
    return 1.0 / OPTIONS.close_scale_ratio <= scale <= OPTIONS.close_scale_ratio
