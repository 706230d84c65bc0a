"""Reads how a floor's plan lies in the world: a matrix, or pairs of points that one is fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.plan_checks import check_matrix, fit_checked
from app.engine.floors.sentences import short
from app.errors import InvalidInputError
from app.geometry.plan import PlanTransform
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignmentOptions:
    """Which correspondences are taken."""

    max_coordinate_m: float = limit(
        1e8,
        "Largest absolute value of a coordinate of a correspondence, and of a matrix.",
        chosen="By hand: larger than every map grid; larger numbers lose millimetres to rounding.",
    )


OPTIONS = AlignmentOptions()


@dataclass(frozen=True, slots=True)
class PlanAlignment:
    """`plan_from_world` (4, 4), its scale, and the root mean square residual of correspondences it was fitted to."""

    matrix: NDArray[np.float64]
    residual_m: float | None
    scale: float


def parse_plan_from_world(value: object, height_m: float | None = None) -> PlanAlignment | None:
    """Return the transform of a request: a 4x4 matrix, or `{"correspondences": [{"world": [x, y, z], "plan":
    [x, y]}, ...]}` fitted by least squares. `height_m` is the height of the floor.

    Raises `InvalidInputError`, also for a matrix or points that a plan and a world in metres can't have.
    """
    if value is None:
        return None
    if isinstance(value, Mapping):
        _check_keys(value, ("correspondences",), "plan_from_world")
        return _fit(value.get("correspondences"), height_m)
    rows = value if isinstance(value, list) else []
    if any(isinstance(cell, bool | str) for row in rows if isinstance(row, list) for cell in row):
        raise InvalidInputError("plan_from_world must be a 4x4 matrix of numbers.")
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError("plan_from_world must be a 4x4 matrix of numbers.") from None
    if matrix.size and not np.abs(matrix).max() <= OPTIONS.max_coordinate_m:
        raise InvalidInputError(
            f"plan_from_world must hold finite numbers of at most {OPTIONS.max_coordinate_m:,.0f}."
        )
    check_matrix(matrix)
    transform = PlanTransform(matrix)
    return PlanAlignment(transform.matrix, None, transform.scale)


def _fit(correspondences: object, height_m: float | None) -> PlanAlignment:
    if (
        not isinstance(correspondences, Sequence)
        or isinstance(correspondences, str)
        or len(correspondences) < 2
    ):
        raise InvalidInputError(
            "plan_from_world.correspondences needs two or more pairs of world and plan points."
        )
    world, plan = [], []
    for pair in correspondences:
        if not isinstance(pair, Mapping) or "world" not in pair or "plan" not in pair:
            raise InvalidInputError('Each correspondence is {"world": [x, y, z], "plan": [x, y]}.')
        _check_keys(pair, ("world", "plan"), "A correspondence")
        world.append(_coordinates(pair["world"], (2, 3), "world"))
        plan.append(_coordinates(pair["plan"], (2,), "plan"))
    columns = min(map(len, world))
    fit = fit_checked(np.array([point[:columns] for point in world]), np.array(plan), height_m)
    return PlanAlignment(fit.matrix, fit.residual_rms_m, fit.scale)


def _check_keys(value: Mapping[str, object], known: tuple[str, ...], name: str) -> None:
    unknown = [key for key in value if key not in known]
    if unknown:
        raise InvalidInputError(f"{name} has no field {short(unknown[0])}: it takes {' and '.join(known)}.")


def _coordinates(value: object, counts: tuple[int, ...], name: str) -> list[float]:
    if isinstance(value, Mapping):
        value = [value[key] for key in ("x", "y", "z") if key in value]
    if not isinstance(value, list | tuple) or len(value) not in counts:
        raise InvalidInputError(
            f"A correspondence's {name} point has {' or '.join(map(str, counts))} numbers."
        )
    if any(isinstance(v, bool) or not isinstance(v, int | float) for v in value):
        raise InvalidInputError(f"A correspondence's {name} point holds something that is not a number.")
    if not all(abs(v) < OPTIONS.max_coordinate_m for v in value):
        raise InvalidInputError(
            f"A correspondence's {name} point is not within {OPTIONS.max_coordinate_m:,.0f} m."
        )
    return [float(v) for v in value]
