"""Checks that the coordinates of a floor's features are plan metres, by where the features lie together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.floor import PlanImage
from app.engine.floors.model import FloorFeatures
from app.engine.floors.plan_units import UNITS
from app.errors import InvalidInputError
from app.geometry.plan import pixels_from_plan
from app.limits import limit

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class CoordinateOptions:
    """What features in metres on a plan look like."""

    min_extent_m: float = limit(
        0.05,
        "Extent of all features of a floor, unless all are at the same place.",
        chosen="By hand: no floor is smaller, and in degrees this is a region of 5 km.",
    )
    max_distance_m: float = limit(
        10_000.0,
        "Distance of the nearest feature from plan (0, 0).",
        chosen="By hand: no venue is larger; coordinates of map grids are hundreds of kilometres.",
    )
    image_margin_ratio: float = limit(
        1.0,
        "Features may lie outside the plan image by its width and height times this.",
        chosen="By hand: a yard or a neighbouring house beside the drawing.",
    )
    outside_ratio: float = limit(
        0.5,
        "Part of the positions that must lie outside for them to be pixels.",
        chosen="By hand: of features in pixels only those near the upper left corner of the image lie inside.",
    )
    min_filled_ratio: float = limit(
        0.3,
        "Part of the plan image's width or height that features must span in another unit for it to be theirs.",
        chosen="By hand: landmarks of a floor lie all over it; divided by 1000 any features lie in one corner.",
    )
    min_unit_ratio: float = limit(
        10.0,
        "Units of which fewer make a metre are not looked for.",
        chosen="By hand: inches and smaller; feet are as near as the other wing of a building whose image shows one.",
    )


OPTIONS = CoordinateOptions()


def check_coordinates(features: FloorFeatures, plan: PlanImage | None) -> None:
    """Raise `InvalidInputError` for features in degrees, in a map grid, or in pixels of the floor's plan image."""
    points = _positions(features)
    if len(points) == 0:
        return
    extent_m = float(np.ptp(points, axis=0).max())
    if 0 < extent_m < OPTIONS.min_extent_m and _can_be_degrees(points):
        raise InvalidInputError(
            f"All features lie within {1e3 * extent_m:.2g} mm of each other: the coordinates look like longitude and "
            "latitude. Add origin with the longitude and latitude of plan (0, 0), or give plan metres."
        )
    nearest_m = float(np.abs(points).max(axis=1).min())
    if nearest_m > OPTIONS.max_distance_m:
        raise InvalidInputError(
            f"All features lie {nearest_m / 1000:,.0f} km or more from plan (0, 0): the coordinates look like those of "
            "a map grid, such as UTM. Give plan metres, or longitude and latitude with origin."
        )
    if plan is not None and _are_pixels(points, plan):
        raise InvalidInputError(
            "The features lie far outside the plan image, but inside it if their coordinates are pixels. Give plan "
            "metres: x = (u - u0) * meters_per_pixel and y = (v0 - v) * meters_per_pixel, with u0, v0 from origin_px."
        )
    unit = None if plan is None else _unit_of(points, plan)
    if unit is not None:
        raise InvalidInputError(
            f"The features lie far outside the plan image, but inside it if their coordinates are {unit}. Give metres."
        )


def _positions(features: FloorFeatures) -> Points:
    """Return all positions (n, 2) of the features."""
    marks = [(mark.x, mark.y) for group in (features.landmarks, features.pois) for mark in group.values()]
    return np.vstack(
        [
            np.array(marks, dtype=np.float64).reshape(-1, 2),
            *(shapely.get_coordinates(area.polygon) for area in features.areas),
            *(link.points for link in features.links),
        ]
    )


def _can_be_degrees(points: Points) -> bool:
    return bool((np.abs(points) <= [180.0, 90.0]).all())


def _are_pixels(points: Points, plan: PlanImage) -> bool:
    if (points < 0).any() or (points > _size_px(plan)).any():
        return False
    return bool(_outside(points, plan, OPTIONS.image_margin_ratio).mean() > OPTIONS.outside_ratio)


def _unit_of(points: Points, plan: PlanImage) -> str | None:
    """Return the unit in which all features lie inside the plan image, None where most lie about it in metres.

    Feet are too near to metres to be told from features of a larger building than the image shows.
    """
    if _outside(points, plan, OPTIONS.image_margin_ratio).mean() <= OPTIONS.outside_ratio:
        return None
    size_m = _size_px(plan) * plan.meters_per_pixel
    for unit, count in sorted(UNITS.items(), key=lambda item: item[1]):
        is_filled = bool((np.ptp(points / count, axis=0) >= OPTIONS.min_filled_ratio * size_m).any())
        if count > OPTIONS.min_unit_ratio and is_filled and not _outside(points / count, plan, 0.0).any():
            return unit
    return None


def _outside(points: Points, plan: PlanImage, margin_ratio: float) -> NDArray[np.bool_]:
    """Return which plan points (n, 2) lie outside the image by more than its size times a ratio."""
    u, v = pixels_from_plan(points[:, 0], points[:, 1], plan.meters_per_pixel, plan.origin_px)
    size, pixels = _size_px(plan), np.column_stack([u, v])
    return np.asarray(((pixels < -margin_ratio * size) | (pixels > (1 + margin_ratio) * size)).any(axis=1))


def _size_px(plan: PlanImage) -> Points:
    return np.array([plan.width_px, plan.height_px], dtype=np.float64)
