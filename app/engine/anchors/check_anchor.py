"""Validation of a monitoring camera and its POIs as a request describes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.poi_triangulation import centroid
from app.engine.floors.floor import Floor
from app.errors import InvalidInputError
from app.geometry.camera_hint import CameraHint
from app.geometry.plan import pixels_from_plan
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorRequestOptions:
    """What a request for an anchor may hold."""

    max_pois: int = limit(50, "Largest number of POIs.", chosen="By hand: far more than one frame shows.")
    max_corners: int = limit(
        50, "Largest number of corners of a POI's region.", chosen="By hand: far more than a region needs."
    )
    max_coordinate_m: float = limit(
        1e6, "Largest absolute coordinate and height.", chosen="By hand: larger than any building."
    )
    max_distance_m: float = limit(
        1000.0, "Largest distance of a POI from the camera.", chosen="By hand: larger than any room."
    )
    min_region_area_px2: float = limit(
        64.0,
        "Least area of a POI's region, in square pixels.",
        chosen="By hand: a smaller region holds no feature.",
    )
    distance_slack_m: float = limit(
        0.1,
        "Constant part of how much a POI's distance may be shorter than its distance on the plan.",
        chosen="By hand: errors of tape and plan.",
    )
    distance_slack_ratio: float = limit(
        0.05,
        "Part of it that grows with the distance, divided by the distance.",
        chosen="By hand: errors of tape and plan.",
    )
    max_rise_m: float = limit(
        50.0,
        "Largest height of a POI above or below its camera, by its distance and its place on the plan.",
        chosen="By hand: higher than any hall; a distance in centimetres gives more.",
    )
    height_error_m: float = limit(
        1.0,
        "Error that a distance may have against the heights that are stated, beside `distance_error_ratio` of it.",
        chosen="By hand: heights are often read from the floor below, and calibration allows as much.",
    )
    distance_error_ratio: float = limit(
        0.1, "Part of that error that grows with the distance.", chosen="By hand: as calibration allows."
    )
    height_slack_m: float = limit(
        20.0,
        "How far a camera may hang outside of its floor's heights, counted from the floor or as in the world.",
        chosen="By hand: mezzanines and halls; a height in centimetres or millimetres is farther away.",
    )
    min_plan_distance_m: float = limit(
        1e-3,
        "Least distance between a POI and the camera on the plan.",
        chosen="By hand: at the camera's own position a POI has no direction on the plan.",
    )
    max_bearing_deg: float = limit(
        90.0,
        "Angle between a POI's bearing and the camera's heading from which the POI lies behind the camera.",
        chosen="By hand: what is behind the camera begins there.",
    )
    max_side_ratio: float = limit(
        2.5,
        "Largest ratio of an image's side to its principal point, for a camera without an image size.",
        chosen="By hand: the principal point lies near the middle of the image.",
    )


OPTIONS = AnchorRequestOptions()


def check_anchor(spec: AnchorSpec, floor: Floor) -> None:
    """Raise `InvalidInputError`, with a sentence that says what to change, when a camera can't have these POIs."""
    _check_pois(spec)
    _check_on_plan(floor, "The camera", spec.x, spec.y)
    _check_height(spec, floor)
    for poi in spec.pois:
        _check_on_plan(floor, f"POI {poi.id!r}", poi.x, poi.y)
        _check_distance(spec, poi)
        _check_region(spec, poi)


def _check_pois(spec: AnchorSpec) -> None:
    if not 1 <= len(spec.pois) <= OPTIONS.max_pois:
        raise InvalidInputError(f"An anchor needs 1 to {OPTIONS.max_pois} pois, got {len(spec.pois)}.")
    ids = [poi.id for poi in spec.pois]
    if len(set(ids)) < len(ids):
        raise InvalidInputError("Two pois have the same id.")
    numbers = [spec.x, spec.y, spec.height_m, *(value for poi in spec.pois for value in (poi.x, poi.y))]
    numbers += [poi.height_m for poi in spec.pois if poi.height_m is not None]
    if not all(abs(value) <= OPTIONS.max_coordinate_m for value in numbers):
        raise InvalidInputError(f"position and height_m must be within {OPTIONS.max_coordinate_m:,.0f} m.")


def _check_on_plan(floor: Floor, what: str, x: float, y: float) -> None:
    if floor.plan is None:
        return
    u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
    if not (-0.5 <= u <= floor.plan.width_px - 0.5 and -0.5 <= v <= floor.plan.height_px - 0.5):
        raise InvalidInputError(
            f"{what} is at ({x:g}, {y:g}) m, outside the plan image of floor {floor.id!r}; give metres on the plan."
        )


def _check_height(spec: AnchorSpec, floor: Floor) -> None:
    ends = np.array([floor.z_min_m, floor.z_max_m])
    if floor.plan_from_world is not None:
        # The heights of the world on the plan's z axis.
        ends = np.sort(floor.plan_from_world[2, 2] * ends + floor.plan_from_world[2, 3])
    low_m = min(float(ends[0]), 0.0) - OPTIONS.height_slack_m
    high_m = max(float(ends[1]), float(np.ptp(ends))) + OPTIONS.height_slack_m
    if not low_m <= spec.height_m <= high_m:
        raise InvalidInputError(
            f"height_m is {spec.height_m:g}, far from the heights {ends[0]:g} to {ends[1]:g} of floor {floor.id!r}: "
            "give metres on the plan's z axis."
        )


def _check_distance(spec: AnchorSpec, poi: Poi) -> None:
    if not 0 < poi.distance_m <= OPTIONS.max_distance_m:
        raise InvalidInputError(
            f"distance_m of POI {poi.id!r} must be above 0 and at most {OPTIONS.max_distance_m:g} m: its distance "
            "from the camera."
        )
    on_plan_m = float(np.hypot(poi.x - spec.x, poi.y - spec.y))
    if on_plan_m < OPTIONS.min_plan_distance_m:
        raise InvalidInputError(
            f"POI {poi.id!r} has the camera's own position, which leaves the plan's direction open."
        )
    if on_plan_m > poi.distance_m * (1 + OPTIONS.distance_slack_ratio) + OPTIONS.distance_slack_m:
        raise InvalidInputError(
            f"POI {poi.id!r} is {on_plan_m:.2f} m from the camera on the plan, but distance_m is only "
            f"{poi.distance_m:g}; the straight distance can't be shorter."
        )
    rise_m = float(np.sqrt(max(poi.distance_m**2 - on_plan_m**2, 0.0)))
    if rise_m > OPTIONS.max_rise_m:
        raise InvalidInputError(
            f"distance_m of POI {poi.id!r} is {poi.distance_m:g}, but on the plan it is {on_plan_m:.2f} m from the "
            f"camera: it would be {rise_m:.0f} m above or below it. Give metres."
        )
    if poi.height_m is not None:
        stated_m = float(np.hypot(on_plan_m, poi.height_m - spec.height_m))
        error_m = OPTIONS.height_error_m + OPTIONS.distance_error_ratio * stated_m
        if abs(poi.distance_m - stated_m) > error_m:
            raise InvalidInputError(
                f"POI {poi.id!r} is {stated_m:.2f} m from the camera by their places on the plan and their heights, "
                f"but distance_m is {poi.distance_m:g}: one of them is wrong."
            )
    if spec.heading_deg is not None:
        bearing = np.degrees(np.arctan2(poi.y - spec.y, poi.x - spec.x)) - spec.heading_deg
        off_heading_deg = abs((bearing + 180.0) % 360.0 - 180.0)
        if off_heading_deg >= OPTIONS.max_bearing_deg:
            raise InvalidInputError(
                f"POI {poi.id!r} lies behind the camera: it is {off_heading_deg:.0f} degrees off heading_deg."
            )


def _check_region(spec: AnchorSpec, poi: Poi) -> None:
    corners = np.array(poi.region_px, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or not 3 <= len(corners) <= OPTIONS.max_corners:
        raise InvalidInputError(
            f"region_px of POI {poi.id!r} needs 3 to {OPTIONS.max_corners} corners [u, v]."
        )
    if not np.isfinite(corners).all():
        raise InvalidInputError(f"region_px of POI {poi.id!r} holds a number that is not finite.")
    if corners.min() >= 0 and corners.max() <= 1:
        raise InvalidInputError(
            f"region_px of POI {poi.id!r} seems to hold shares of the image's width and height; give pixels."
        )
    width, height = _image_size(spec.camera)
    if (corners < -0.5).any() or (corners > np.array([width, height]) - 0.5).any():
        raise InvalidInputError(f"region_px of POI {poi.id!r} lies outside the camera's image.")
    outline = shapely.LinearRing(corners)
    if not outline.is_simple and outline.convex_hull.area >= OPTIONS.min_region_area_px2:
        raise InvalidInputError(
            f"region_px of POI {poi.id!r} crosses itself; give its corners in their order around the object."
        )
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * abs(float(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1])))
    if area < OPTIONS.min_region_area_px2:
        raise InvalidInputError(
            f"region_px of POI {poi.id!r} covers {area:.0f} pixels; draw it around the whole object."
        )
    own = spec.camera.camera
    if own is not None and not np.isfinite(own.normalize(centroid(corners))).all():
        raise InvalidInputError(f"region_px of POI {poi.id!r} lies where the lens model sees nothing.")


def _image_size(hint: CameraHint) -> tuple[float, float]:
    """Return width and height of the image, or the largest possible ones of a camera without an image size."""
    if hint.camera is not None:
        return hint.camera.width, hint.camera.height
    return OPTIONS.max_side_ratio * hint.values[2], OPTIONS.max_side_ratio * hint.values[3]
