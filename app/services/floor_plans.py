"""Floors and their plans: validation, and where a pose lies on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import DegenerateGeometryError, InvalidInputError
from app.geometry.plan import PlanTransform, fit_plan_from_world, pixels_from_plan, plan_position
from app.geometry.se3 import Pose
from app.services.resources import Resources
from app.storage.db import hold_blobs
from app.storage.floors import Floor, PlanImage, set_plan_image
from app.vision.images import decode_image

# People hold a camera this far above the floor's highest or below its lowest point at most.
HEIGHT_SLACK_M = 0.3
# No venue is larger; larger numbers lose their metres to rounding.
MAX_COORDINATE_M = 1e8
PLAN_MEDIA_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}


@dataclass(frozen=True, slots=True)
class PlanPoint:
    """A point on a floor's plan: metres, degrees counter-clockwise from plan x, pixels of the plan image.

    Area and nearest landmark are ids, their names beside them; `FeatureLibrary.described` fills them in.
    """

    x: float
    y: float
    heading_deg: float
    u_px: float | None
    v_px: float | None
    area: str | None = None
    area_name: str | None = None
    nearest_landmark: str | None = None
    nearest_landmark_name: str | None = None
    nearest_landmark_m: float | None = None


@dataclass(frozen=True, slots=True)
class PlanAlignment:
    """`plan_from_world` (4, 4), and how well it fits the correspondences it was made from, if any."""

    matrix: NDArray[np.float64]
    residual_m: float | None
    scale: float


def parse_plan_from_world(value: object) -> PlanAlignment | None:
    """Return the transform of a request: a 4x4 matrix, or `{"correspondences": [{"world": [x, y, z], "plan":
    [x, y]}, ...]}` fitted by least squares. Raises `InvalidInputError`."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        return _fit(value.get("correspondences"))
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InvalidInputError("plan_from_world must be a 4x4 matrix of numbers.") from None
    transform = PlanTransform(matrix)
    return PlanAlignment(transform.matrix, None, transform.scale)


def _fit(correspondences: object) -> PlanAlignment:
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
        world.append(_coordinates(pair["world"], (2, 3), "world")[:2])
        plan.append(_coordinates(pair["plan"], (2,), "plan"))
    try:
        fit = fit_plan_from_world(np.array(world), np.array(plan))
    except DegenerateGeometryError as error:
        raise InvalidInputError(str(error)) from None
    return PlanAlignment(fit.matrix, fit.residual_rms_m, fit.scale)


def _coordinates(value: object, counts: tuple[int, ...], name: str) -> list[float]:
    if isinstance(value, Mapping):
        value = [value[key] for key in ("x", "y", "z") if key in value]
    if not isinstance(value, list | tuple) or len(value) not in counts:
        raise InvalidInputError(
            f"A correspondence's {name} point has {' or '.join(map(str, counts))} numbers."
        )
    if any(isinstance(v, bool) or not isinstance(v, int | float) for v in value):
        raise InvalidInputError(f"A correspondence's {name} point holds something that is not a number.")
    if not all(abs(v) < MAX_COORDINATE_M for v in value):
        raise InvalidInputError(f"A correspondence's {name} point is not within {MAX_COORDINATE_M:,.0f} m.")
    return [float(v) for v in value]


def store_plan_image(
    resources: Resources,
    venue_id: str,
    floor_id: str,
    data: bytes,
    meters_per_pixel: float,
    origin_px: tuple[float, float],
) -> Floor:
    """Check and store a floor's plan image; raises `InvalidImageError`, `InvalidInputError`, `NotFoundError`."""
    if not (np.isfinite(meters_per_pixel) and 1e-5 <= meters_per_pixel <= 10):
        raise InvalidInputError("meters_per_pixel must be between 0.00001 and 10.")
    if not np.isfinite(origin_px).all():
        raise InvalidInputError("origin_px must be two finite numbers: the pixel of plan (0, 0).")
    media_type = next((kind for magic, kind in PLAN_MEDIA_TYPES.items() if data.startswith(magic)), None)
    if data and media_type is None:
        raise InvalidInputError("A plan image must be a PNG or JPEG file.")
    height, width = decode_image(data, resources.settings.max_image_pixels).shape[:2]
    assert media_type is not None  # noqa: S101 - empty data was refused by decode_image
    plan = PlanImage(resources.blobs.put(data), media_type, width, height, meters_per_pixel, origin_px)
    with resources.database.write() as connection:
        hold_blobs(connection)
        if not resources.blobs.contains(plan.blob):
            resources.blobs.put(data)
        return set_plan_image(connection, venue_id, floor_id, plan)


def floor_of(floors: Sequence[Floor], world_from_camera: Pose) -> Floor | None:
    """Return the floor whose heights hold the camera, the nearest one in the slack, or None."""
    z = float(world_from_camera.translation[2])

    def outside_m(floor: Floor) -> float:
        return max(floor.z_min_m - z, z - floor.z_max_m, 0.0)

    best = min(floors, key=outside_m, default=None)
    return best if best is not None and outside_m(best) <= HEIGHT_SLACK_M else None


def plan_point(floor: Floor, world_from_camera: Pose) -> PlanPoint | None:
    """Return where a camera is on a floor's plan, or None for a floor without `plan_from_world`."""
    if floor.plan_from_world is None:
        return None
    x, y, heading_deg = plan_position(floor.plan_from_world, world_from_camera)
    u_px = v_px = None
    if floor.plan is not None:
        u, v = pixels_from_plan(x, y, floor.plan.meters_per_pixel, floor.plan.origin_px)
        u_px, v_px = float(u), float(v)
    return PlanPoint(x, y, heading_deg, u_px, v_px)


def as_dict(floor: Floor) -> dict[str, Any]:
    """Return a floor as the API shows it."""
    plan = floor.plan
    return {
        "venue": floor.venue_id,
        "id": floor.id,
        "name": floor.name,
        "level": floor.level,
        "z_min_m": floor.z_min_m,
        "z_max_m": floor.z_max_m,
        "plan_from_world": None if floor.plan_from_world is None else floor.plan_from_world.tolist(),
        "plan_residual_m": floor.plan_residual_m,
        "plan": None
        if plan is None
        else {
            "media_type": plan.media_type,
            "width_px": plan.width_px,
            "height_px": plan.height_px,
            "meters_per_pixel": plan.meters_per_pixel,
            "origin_px": list(plan.origin_px),
        },
    }
