"""Anchors: what a monitoring camera may be, and what becomes of the frames it pushes."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from app.errors import InvalidImageError, InvalidInputError
from app.geometry.camera import Camera
from app.geometry.plan import pixels_from_plan
from app.services.anchor_features import AnchorDescriber, AnchorFeatures
from app.services.anchor_sights import centroid, inside_region, region_in
from app.services.resources import Resources
from app.storage.anchors import (
    Anchor,
    AnchorFrameRow,
    AnchorSpec,
    Poi,
    camera_as_json,
    get_anchor,
    put_anchor,
    set_frame,
)
from app.storage.db import hold_blobs, now
from app.storage.floors import Floor, get_floor
from app.storage.sweep import discard_blobs
from app.storage.venues import get_venue
from app.vision.images import decode_image

MAX_POIS, MAX_CORNERS = 50, 50
MAX_COORDINATE_M, MAX_DISTANCE_M = 1e6, 1000.0
# A region with fewer pixels holds no feature; one with fewer features can't be recognised.
MIN_REGION_AREA_PX = 64.0
MIN_REGION_FEATURES = 5
# A distance may be this much shorter than its part along the floor, by errors of tape and plan.
DISTANCE_SLACK_M, DISTANCE_SLACK_SHARE = 0.1, 0.05
# Numbers without an image size: no image reaches further than this many times its principal point.
MAX_SIDE_PER_CENTER = 2.5


@dataclass(frozen=True, slots=True)
class PushedFrame:
    """What became of a frame: its id, features, the POIs that can be recognised in it, and when it came."""

    frame: str
    features: int
    pois_visible: tuple[str, ...]
    received_at: datetime


def store_anchor(resources: Resources, anchor_id: str, spec: AnchorSpec) -> Anchor:
    """Check and store an anchor; raises `NotFoundError`, `InvalidInputError` or `ConflictError`."""
    _check_pois(spec)
    with resources.database.write() as connection:
        get_venue(connection, spec.venue_id)
        floor = get_floor(connection, spec.venue_id, spec.floor_id)
        _check_on_plan(floor, "The camera", spec.x, spec.y)
        for poi in spec.pois:
            _check_on_plan(floor, f"POI {poi.id!r}", poi.x, poi.y)
            _check_distance(spec, poi)
            _check_region(spec, poi)
        return put_anchor(connection, anchor_id, spec)


def push_frame(resources: Resources, describer: AnchorDescriber, anchor_id: str, image: bytes) -> PushedFrame:
    """Make an image the anchor's newest frame.

    Raises `NotFoundError` for an unknown anchor, `InvalidImageError` for bytes that are no usable image,
    `InvalidInputError` for one that doesn't fit the anchor's camera.
    """
    received_at = now()
    with resources.database.read() as connection:
        anchor = get_anchor(connection, anchor_id)
    rgb = decode_image(image, resources.settings.max_image_pixels)
    camera = frame_camera(anchor.spec, rgb.shape[1], rgb.shape[0])
    features = describer.describe(rgb)
    visible = visible_pois(anchor.spec, camera, features)
    blob = resources.blobs.put(image) if anchor.spec.store_images else None
    count = len(features.akaze) + len(features.xfeat)
    frame = AnchorFrameRow(anchor_id, uuid.uuid4().hex, received_at, camera, count, visible, blob)
    with resources.database.write() as connection:
        hold_blobs(connection)
        if get_anchor(connection, anchor_id).spec != anchor.spec:
            raise InvalidInputError("The anchor was changed while its frame was read; push the frame again.")
        if blob is not None and not resources.blobs.contains(blob):
            resources.blobs.put(image)
        unneeded = set_frame(connection, frame, features.pack())
    if unneeded is not None:
        discard_blobs(resources.database, resources.blobs, [unneeded])
    return PushedFrame(frame.id, count, visible, received_at)


def frame_camera(spec: AnchorSpec, width: int, height: int) -> Camera:
    """Return the intrinsics of a frame of that size; raises `InvalidInputError` when the anchor's don't fit it, or
    when a region then lies outside."""
    if isinstance(spec.camera, Camera):
        camera = spec.camera.scaled_to(width, height)
    else:
        camera = Camera.from_values(spec.camera, width, height)
    for poi in spec.pois:
        if not camera.contains(region_in(poi, spec, camera)).all():
            raise InvalidInputError(
                f"The region of POI {poi.id!r} lies outside the frame of {width} x {height} pixels; PUT the anchor "
                "again with the region in pixels of its frames."
            )
    return camera


def visible_pois(spec: AnchorSpec, camera: Camera, features: AnchorFeatures) -> tuple[str, ...]:
    """Return the POIs in whose region a frame has features to recognise them by."""
    points = np.concatenate([features.akaze.keypoints_px, features.xfeat.keypoints_px]).astype(np.float64)
    return tuple(
        poi.id
        for poi in spec.pois
        if np.count_nonzero(inside_region(points, region_in(poi, spec, camera))) >= MIN_REGION_FEATURES
    )


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
        raise InvalidImageError(f"region_px of POI {poi.id!r} lies where the lens model sees nothing.")


def _image_size(camera: Camera | tuple[float, ...]) -> tuple[float, float]:
    """Return the image's size, or the largest one that fits numbers without a size."""
    if isinstance(camera, Camera):
        return camera.width, camera.height
    return MAX_SIDE_PER_CENTER * camera[2], MAX_SIDE_PER_CENTER * camera[3]


def anchor_as_dict(anchor: Anchor, frame: AnchorFrameRow | None, default_max_age_s: float) -> dict[str, Any]:
    """Return an anchor as the API shows it."""
    spec = anchor.spec
    max_age_s = default_max_age_s if spec.max_age_s is None else spec.max_age_s
    age_s = None if frame is None else (now() - frame.received_at).total_seconds()
    return {
        "id": anchor.id,
        "venue": spec.venue_id,
        "floor": spec.floor_id,
        "position": {"x": spec.x, "y": spec.y},
        "height_m": spec.height_m,
        "heading_deg": spec.heading_deg,
        "camera": camera_as_json(spec.camera),
        "pois": [_poi_as_dict(poi) for poi in spec.pois],
        "store_images": spec.store_images,
        "max_age_s": max_age_s,
        "calibration": anchor.calibration,
        "uses": anchor.uses,
        "last_used_at": anchor.last_used_at,
        "frame": None
        if frame is None or age_s is None
        else {
            "id": frame.id,
            "received_at": frame.received_at,
            "age_s": round(age_s, 3),
            "fresh": age_s <= max_age_s,
            "features": frame.feature_count,
            "pois_visible": list(frame.pois_visible),
            "image_stored": frame.image_blob is not None,
        },
    }


def _poi_as_dict(poi: Poi) -> dict[str, Any]:
    return {
        "id": poi.id,
        "region_px": [list(corner) for corner in poi.region_px],
        "position": {"x": poi.x, "y": poi.y},
        "distance_m": poi.distance_m,
        "height_m": poi.height_m,
    }
