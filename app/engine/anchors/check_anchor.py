"""Whether a monitoring camera can be what a request says it is."""

from __future__ import annotations

import numpy as np

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.poi_triangulation import centroid
from app.engine.floors.floor import Floor
from app.errors import InvalidInputError
from app.geometry.camera import Camera
from app.geometry.plan import pixels_from_plan

MAX_POIS, MAX_CORNERS = 50, 50
MAX_COORDINATE_M, MAX_DISTANCE_M = 1e6, 1000.0
# A region with fewer pixels holds no feature.
MIN_REGION_AREA_PX = 64.0
# A distance may be this much shorter than its part along the floor, by errors of tape and plan.
DISTANCE_SLACK_M, DISTANCE_SLACK_SHARE = 0.1, 0.05
# Numbers without an image size: no image reaches further than this many times its principal point.
MAX_SIDE_PER_CENTER = 2.5


def check_anchor(spec: AnchorSpec, floor: Floor) -> None:
    """Raise `InvalidInputError`, with a sentence that says what to change, unless a camera can have these POIs."""
    _check_pois(spec)
    _check_on_plan(floor, "The camera", spec.x, spec.y)
    for poi in spec.pois:
        _check_on_plan(floor, f"POI {poi.id!r}", poi.x, poi.y)
        _check_distance(spec, poi)
        _check_region(spec, poi)


def _check_pois(spec: AnchorSpec) -> None:
    if not 1 <= len(spec.pois) <= MAX_POIS:
        raise InvalidInputError(f"An anchor needs 1 to {MAX_POIS} pois, got {len(spec.pois)}.")
    ids = [poi.id for poi in spec.pois]
    if len(set(ids)) < len(ids):
        raise InvalidInputError("Two pois have the same id.")
    numbers = [spec.x, spec.y, spec.height_m, *(value for poi in spec.pois for value in (poi.x, poi.y))]
    numbers += [poi.height_m for poi in spec.pois if poi.height_m is not None]
    if not all(abs(value) <= MAX_COORDINATE_M for value in numbers):
        raise InvalidInputError(f"position and height_m must be within {MAX_COORDINATE_M:,.0f} m.")


def _check_on_plan(floor: Floor, what: str, x: float, y: float) -> None:
    if floor.plan is None:
        return
    u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
    if not (-0.5 <= u <= floor.plan.width_px - 0.5 and -0.5 <= v <= floor.plan.height_px - 0.5):
        raise InvalidInputError(
            f"{what} is at ({x:g}, {y:g}) m, outside the plan image of floor {floor.id!r}; give metres on the plan."
        )


def _check_distance(spec: AnchorSpec, poi: Poi) -> None:
    if not 0 < poi.distance_m <= MAX_DISTANCE_M:
        raise InvalidInputError(
            f"distance_m of POI {poi.id!r} must be above 0 and at most {MAX_DISTANCE_M:g} m: its distance from the "
            "camera."
        )
    along_floor = float(np.hypot(poi.x - spec.x, poi.y - spec.y))
    if along_floor < 1e-3:
        raise InvalidInputError(
            f"POI {poi.id!r} has the camera's own position, which leaves the plan's direction open."
        )
    if along_floor > poi.distance_m * (1 + DISTANCE_SLACK_SHARE) + DISTANCE_SLACK_M:
        raise InvalidInputError(
            f"POI {poi.id!r} is {along_floor:.2f} m from the camera on the plan, but distance_m is only "
            f"{poi.distance_m:g}; the straight distance can't be shorter."
        )
    if spec.heading_deg is not None:
        bearing = np.degrees(np.arctan2(poi.y - spec.y, poi.x - spec.x)) - spec.heading_deg
        if abs((bearing + 180.0) % 360.0 - 180.0) >= 90.0:
            raise InvalidInputError(
                f"POI {poi.id!r} lies behind the camera: it is {abs((bearing + 180.0) % 360.0 - 180.0):.0f} degrees "
                "off heading_deg."
            )


def _check_region(spec: AnchorSpec, poi: Poi) -> None:
    corners = np.array(poi.region_px, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or not 3 <= len(corners) <= MAX_CORNERS:
        raise InvalidInputError(f"region_px of POI {poi.id!r} needs 3 to {MAX_CORNERS} corners [u, v].")
    if not np.isfinite(corners).all():
        raise InvalidInputError(f"region_px of POI {poi.id!r} holds a number that is not finite.")
    width, height = _image_size(spec.camera)
    if (corners < -0.5).any() or (corners > np.array([width, height]) - 0.5).any():
        raise InvalidInputError(f"region_px of POI {poi.id!r} lies outside the camera's image.")
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * abs(float(np.sum(corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1])))
    if area < MIN_REGION_AREA_PX:
        raise InvalidInputError(
            f"region_px of POI {poi.id!r} covers {area:.0f} pixels; draw it around the whole object."
        )
    if isinstance(spec.camera, Camera) and not np.isfinite(spec.camera.normalize(centroid(corners))).all():
        raise InvalidInputError(f"region_px of POI {poi.id!r} lies where the lens model sees nothing.")


def _image_size(camera: Camera | tuple[float, ...]) -> tuple[float, float]:
    """Return the image's size, or the largest one that fits numbers without a size."""
    if isinstance(camera, Camera):
        return camera.width, camera.height
    return MAX_SIDE_PER_CENTER * camera[2], MAX_SIDE_PER_CENTER * camera[3]
