"""Which keyframes a query is asked of when its place is partly known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.floor import Floor
from app.engine.floors.model import Area
from app.engine.floors.options import OPTIONS as FLOOR
from app.engine.floors.places import within_areas
from app.geometry.plan import PlanTransform
from app.limits import limit

AreaOnFloor = tuple[Floor, Area]


@dataclass(frozen=True, slots=True, kw_only=True)
class NarrowingOptions:
    """How far around a stated place keyframes are used."""

    margin_m: float = limit(
        3.0,
        "Keyframes this far outside a stated area or radius may see what a camera inside sees.",
        chosen="By hand: the depth of a room.",
    )


OPTIONS = NarrowingOptions()


@dataclass(frozen=True, slots=True)
class Prior:
    """Where the camera may be: within `radius_m` of a world position (3,)."""

    position: tuple[float, float, float]
    radius_m: float


def allowed_keyframes(
    positions: NDArray[np.float64],
    floor: Floor | None,
    areas: list[AreaOnFloor] | None,
    prior: Prior | None,
) -> NDArray[np.int64] | None:
    """Return the keyframes at `positions` (n, 3) that floor, areas and prior leave, or None when none of them is
    given."""
    if floor is None and prior is None and areas is None:
        return None
    keep = np.ones(len(positions), dtype=bool)
    if floor is not None:
        keep &= _on_floor(positions, floor)
    if areas is not None:
        keep &= _in_areas(positions, areas)
    if prior is not None:
        distances = np.linalg.norm(positions - np.array(prior.position), axis=1)
        keep &= distances <= prior.radius_m + OPTIONS.margin_m
    return np.flatnonzero(keep).astype(np.int64)


def _on_floor(positions: NDArray[np.float64], floor: Floor) -> NDArray[np.bool_]:
    """Return which world positions (n, 3) are at a floor's heights."""
    heights = positions[:, 2]
    return np.asarray(
        (heights >= floor.z_min_m - FLOOR.height_slack_m) & (heights <= floor.z_max_m + FLOOR.height_slack_m)
    )


def _in_areas(positions: NDArray[np.float64], areas: list[AreaOnFloor]) -> NDArray[np.bool_]:
    """Return which world positions (n, 3) are in or near one of the areas; nowhere on a floor without a plan
    in the world."""
    keep = np.zeros(len(positions), dtype=bool)
    for floor, area in areas:
        if floor.plan_from_world is not None:
            on_plan = PlanTransform(floor.plan_from_world).apply(positions)[:, :2]
            keep |= _on_floor(positions, floor) & within_areas(on_plan, [area], OPTIONS.margin_m)
    return keep
