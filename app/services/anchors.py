"""Anchors: what a monitoring camera may be, and what becomes of the frames it pushes."""

from __future__ import annotations

import uuid
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import cv2
import numpy as np

from app.engine.anchors.anchor import Anchor, AnchorSpec, Poi
from app.engine.anchors.calibration import calibrate_in_map, calibration_of
from app.engine.anchors.check_anchor import check_anchor
from app.engine.anchors.features import AnchorDescriber, AnchorFeatures
from app.engine.anchors.map_depth import SeenPoints
from app.engine.anchors.poi_triangulation import inside_region, region_in, regions_in
from app.errors import ConflictError, InvalidInputError, NotFoundError
from app.geometry.camera import Camera
from app.limits import limit
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.anchors import (
    AnchorFrameRow,
    get_anchor,
    list_frames,
    put_anchor,
    set_calibration,
    set_frame,
)
from app.storage.db import hold_blobs, now
from app.storage.floors import get_floor
from app.storage.sweep import discard_blobs
from app.storage.venues import get_venue
from app.vision.faces.blur import with_blurred_faces
from app.vision.images import Rgb, decode_image

# A region with fewer features can't be recognised.
MIN_REGION_FEATURES = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorPictureOptions:
    """How a stored frame is shown to people."""

    jpeg_quality: int = limit(90, "JPEG quality of a monitoring camera's newest frame.", chosen="By hand.")


OPTIONS = AnchorPictureOptions()


@dataclass(frozen=True, slots=True)
class PushedFrame:
    """What became of a frame: its id, features, the POIs that can be recognised in it, and when it came."""

    frame: str
    features: int
    pois_visible: tuple[str, ...]
    received_at: datetime


class AnchorService:
    """Keeps monitoring cameras and what they push. Safe to share between threads."""

    def __init__(self, resources: Resources, library: MapLibrary, describer: AnchorDescriber) -> None:
        self._resources = resources
        self._library = library
        self._describer = describer

    def put(self, anchor_id: str, spec: AnchorSpec) -> Anchor:
        """Check and store an anchor; raises `NotFoundError`, `InvalidInputError` or `ConflictError`."""
        with self._resources.database.write() as connection:
            get_venue(connection, spec.venue_id)
            check_anchor(spec, get_floor(connection, spec.venue_id, spec.floor_id))
            return put_anchor(connection, anchor_id, spec)

    def push(self, anchor_id: str, image: bytes) -> PushedFrame:
        """Make an image the anchor's newest frame.

        Raises `NotFoundError` for an unknown anchor, `InvalidImageError` for bytes that are no usable image,
        `InvalidInputError` for one that doesn't fit the anchor's camera.
        """
        received_at = now()
        with self._resources.database.read() as connection:
            anchor = get_anchor(connection, anchor_id)
        rgb = decode_image(image, self._resources.settings.max_image_pixels)
        return self._store(anchor, image, rgb, received_at)

    def calibrate(self, anchor_id: str, image: bytes | None) -> Anchor:
        """Locate an anchor's camera in its venue's map, by the image or the newest frame that was stored as one.

        The image becomes the newest frame, its features with distances by the map. Raises `ConflictError` without
        a map, without an image, or when the map doesn't show what the camera sees.
        """
        received_at = now()
        with self._resources.database.read() as connection:
            anchor = get_anchor(connection, anchor_id)
            floor = get_floor(connection, anchor.spec.venue_id, anchor.spec.floor_id)
        serving = self._library.active(anchor.spec.venue_id)
        if serving is None:
            raise ConflictError(
                f"Venue {anchor.spec.venue_id!r} has no map to calibrate the camera in; build one first."
            )
        image = image or self._stored_image(anchor_id)
        rgb = decode_image(image, self._resources.settings.max_image_pixels)
        camera = frame_camera(anchor.spec, rgb.shape[1], rgb.shape[0])
        opened, version = serving
        calibration = {
            **calibrate_in_map(opened, version.version, floor, anchor.spec, camera, rgb),
            "calibrated_at": now().isoformat(),
        }
        with self._resources.database.write() as connection:
            anchor = set_calibration(connection, anchor_id, calibration)
        self._store(anchor, image, rgb, received_at)
        return anchor

    def picture(self, anchor_id: str) -> bytes:
        """Return the newest frame that was stored as an image, as JPEG of the frame's size, upright.

        Raises `NotFoundError` for an unknown anchor, and for one of which no image is stored.
        """
        with self._resources.database.read() as connection:
            get_anchor(connection, anchor_id)
            frame = list_frames(connection, [anchor_id]).get(anchor_id)
        if frame is None or frame.image_blob is None:
            raise NotFoundError(
                f"No picture of {anchor_id!r} is stored: store_images is false, or no frame came yet."
            )
        rgb = decode_image(
            self._resources.blobs.get(frame.image_blob), self._resources.settings.max_image_pixels
        )
        flags = [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality]
        return cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), flags)[1].tobytes()

    def _stored_image(self, anchor_id: str) -> bytes:
        with self._resources.database.read() as connection:
            frame = list_frames(connection, [anchor_id]).get(anchor_id)
        if frame is None or frame.image_blob is None:
            raise ConflictError(
                "Send the camera's picture with this call: no frame's image is stored (store_images is false, or no "
                "frame came yet)."
            )
        return self._resources.blobs.get(frame.image_blob)

    def _store(self, anchor: Anchor, image: bytes, rgb: Rgb, received_at: datetime) -> PushedFrame:
        resources, spec = self._resources, anchor.spec
        camera = frame_camera(spec, rgb.shape[1], rgb.shape[0])
        described = self._describer.describe(rgb, camera, regions_in(spec, camera))
        features = self._with_lengths(anchor, camera, described)
        visible = visible_pois(spec, camera, features)
        if spec.store_images and resources.settings.blur_anchor_faces:
            image = with_blurred_faces(image, resources.models.faces) or image
        blob = resources.blobs.put(image) if spec.store_images else None
        count = len(features.akaze) + len(features.xfeat)
        frame = AnchorFrameRow(
            anchor_id=anchor.id,
            id=uuid.uuid4().hex,
            received_at=received_at,
            camera=camera,
            feature_count=count,
            pois_visible=visible,
            image_blob=blob,
        )
        with resources.database.write() as connection:
            hold_blobs(connection)
            present = get_anchor(connection, anchor.id)
            if (present.spec, present.calibration) != (spec, anchor.calibration):
                raise ConflictError("The anchor was changed while its frame was read; push the frame again.")
            if blob is not None and not resources.blobs.contains(blob):
                resources.blobs.put(image)
            unneeded = set_frame(connection, frame, features.pack())
        if unneeded is not None:
            discard_blobs(resources.database, resources.blobs, [unneeded])
        return PushedFrame(frame.id, count, visible, received_at)

    @staticmethod
    def _with_lengths(anchor: Anchor, camera: Camera, features: AnchorFeatures) -> AnchorFeatures:
        """Return a calibrated camera's features with their distances by the map; others as they are."""
        calibration = calibration_of(anchor.calibration)
        if calibration is None or calibration.points is None:
            return features
        seen = SeenPoints.unpack(calibration.points, camera)
        akaze = seen.lengths_at(features.akaze.keypoints_px.astype(np.float64), camera)
        xfeat = seen.lengths_at(features.xfeat.keypoints_px.astype(np.float64), camera)
        return replace(
            features, akaze_length_m=akaze.astype(np.float32), xfeat_length_m=xfeat.astype(np.float32)
        )


def frame_camera(spec: AnchorSpec, width: int, height: int) -> Camera:
    """Return the intrinsics of a frame of that size; raises `InvalidInputError` when the anchor's don't fit it, or
    when a region then lies outside."""
    camera = spec.camera.for_image(width, height)
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
        "camera": spec.camera.to_json(),
        "pois": [_poi_as_dict(poi) for poi in spec.pois],
        "store_images": spec.store_images,
        "max_age_s": max_age_s,
        "calibration": None if anchor.calibration is None else _without_points(anchor.calibration),
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


def _without_points(calibration: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in calibration.items() if name != "points"}


def _poi_as_dict(poi: Poi) -> dict[str, Any]:
    return {
        "id": poi.id,
        "region_px": [list(corner) for corner in poi.region_px],
        "position": {"x": poi.x, "y": poi.y},
        "distance_m": poi.distance_m,
        "height_m": poi.height_m,
    }
