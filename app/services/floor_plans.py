"""Plan images of floors: checked and stored."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.engine.floors.floor import Floor, PlanImage
from app.errors import InvalidInputError
from app.services.resources import Resources
from app.storage.db import hold_blobs
from app.storage.floors import set_plan_image
from app.vision.images import decode_image

PLAN_MEDIA_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}


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
    plan = PlanImage(
        blob=resources.blobs.put(data),
        media_type=media_type,
        width_px=width,
        height_px=height,
        meters_per_pixel=meters_per_pixel,
        origin_px=origin_px,
    )
    with resources.database.write() as connection:
        hold_blobs(connection)
        if not resources.blobs.contains(plan.blob):
            resources.blobs.put(data)
        return set_plan_image(connection, venue_id, floor_id, plan)


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
