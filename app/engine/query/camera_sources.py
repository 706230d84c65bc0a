"""Where a query's camera comes from: the request, the photo's EXIF, a list of phones, or a search."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from app.engine.query.stated_camera import stated_camera
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.focal import ApproximateCamera, pinhole
from app.limits import limit
from app.vision.exif import PhotoTags, read_photo_tags
from app.vision.images import Rgb, quarter_turns_of
from app.vision.phone_cameras import PhoneCamera, find_phone

CameraSource = Literal["request", "request_turned", "refined", "exif", "phone_database", "search", "unknown"]

# The diagonal of 35 mm film, to which equivalent focal lengths refer (CIPA DC-008).
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoOptions:
    """How a photo's tags are compared with its pixels."""

    phone_aspect: float = limit(
        4 / 3, "Aspect ratio of phones' sensors.", chosen="By hand: the common sensor."
    )
    film_aspect: float = limit(3 / 2, "Aspect ratio of cameras' sensors.", chosen="By hand: 35 mm film.")
    aspect_tolerance: float = limit(
        0.02, "Relative tolerance of an aspect ratio.", chosen="By hand: rounding to whole macroblocks."
    )
    same_lens_tolerance: float = limit(
        0.1,
        "A lens within this relative tolerance of the main camera's focal length is the main camera.",
        chosen="By hand: other lenses differ by 1.5 times and more.",
    )


OPTIONS = PhotoOptions()


@dataclass(frozen=True, slots=True)
class QueryCamera:
    """What is known of a query's camera: exact, approximate or nothing, and who says so."""

    camera: Camera | ApproximateCamera | None
    source: CameraSource

    @property
    def likely(self) -> Camera | None:
        """The camera, exact or approximate, None where nothing is known."""
        return self.camera.camera if isinstance(self.camera, ApproximateCamera) else self.camera

    def source_of(self, used: Camera | None) -> CameraSource:
        """Return where the camera that was used in the end comes from: a search may have left what was known."""
        if used is None:
            return "unknown"
        if isinstance(self.camera, ApproximateCamera) and not self.camera.covers(used):
            return "search"
        return self.source


def query_camera(
    given: CameraHint | None, rgb: Rgb, image: bytes, quarter_turns: int | None = None
) -> QueryCamera:
    """Return what is known of the camera of an image (h, w, 3) that was decoded from these bytes.

    `quarter_turns` is by how many the image was turned upright, read from the bytes where it is not given.
    Raises `InvalidCameraError` with the likely cause when the camera that was given can't be the image's own.
    """
    height, width = rgb.shape[:2]
    if given is None:
        return camera_from_tags(read_photo_tags(image), width, height)
    turns = quarter_turns_of(image) if quarter_turns is None else quarter_turns
    stated = stated_camera(given, width, height, turns)
    return QueryCamera(stated.camera, "request_turned" if stated.is_turned else "request")


def camera_from_tags(tags: PhotoTags, width: int, height: int) -> QueryCamera:
    """Return the approximate camera of a photo by its EXIF, for the photo's size now.

    A photo that was cut after it was taken has tags that don't hold any more; it is searched for.
    """
    if _was_cut(tags, width, height):
        return QueryCamera(None, "search")
    phone = find_phone(tags.make, tags.model)
    focal_35mm = _focal_35mm(tags, phone)
    if focal_35mm is not None:
        return _query_camera(focal_from_35mm(focal_35mm, width, height), width, height, "exif")
    if tags.focal_mm is not None and tags.plane_px_per_mm is not None and tags.recorded_size is not None:
        scale = max(width, height) / max(tags.recorded_size)
        focal_px = tags.focal_mm * tags.plane_px_per_mm * tags.digital_zoom * scale
        return _query_camera(focal_px, width, height, "exif")
    if tags.focal_mm is None and phone is not None:
        focal_px = focal_from_35mm(phone.focal_35mm * tags.digital_zoom, width, height)
        return _query_camera(focal_px, width, height, "phone_database")
    return QueryCamera(None, "search")


def _focal_35mm(tags: PhotoTags, phone: PhoneCamera | None) -> float | None:
    """Return the equivalent focal length of the photo with its digital zoom, None where tags don't tell."""
    if tags.focal_35mm is not None:
        # Most makers put the zoom into the equivalent; it is not in when the equivalent is the lens's own.
        bare = phone is not None and abs(tags.focal_35mm / phone.focal_35mm - 1) < OPTIONS.same_lens_tolerance
        return tags.focal_35mm * (tags.digital_zoom if bare else 1.0)
    if tags.focal_mm is None or tags.plane_px_per_mm is not None or phone is None or phone.focal_mm is None:
        return None
    # Of the phone's other lenses neither sensor nor equivalent is known.
    if abs(tags.focal_mm / phone.focal_mm - 1) > OPTIONS.same_lens_tolerance:
        return None
    return tags.focal_mm * phone.focal_35mm / phone.focal_mm * tags.digital_zoom


def focal_from_35mm(focal_35mm: float, width: int, height: int) -> float:
    """Return the focal length in pixels of a 35 mm equivalent, which compares diagonals (CIPA DC-008).

    The diagonal is the whole sensor's: a picture that is wider than its sensor lost rows, a squarer one columns.
    """
    longer, shorter = max(width, height), min(width, height)
    aspect = longer / shorter
    if abs(aspect / OPTIONS.film_aspect - 1) < OPTIONS.aspect_tolerance:
        diagonal_px = math.hypot(longer, shorter)
    else:
        diagonal_px = 1.25 * max(longer, shorter * OPTIONS.phone_aspect)
    return focal_35mm / FILM_DIAGONAL_MM * diagonal_px


def _was_cut(tags: PhotoTags, width: int, height: int) -> bool:
    if tags.recorded_size is None:
        return False
    then = max(tags.recorded_size) / min(tags.recorded_size)
    now = max(width, height) / min(width, height)
    return abs(then / now - 1) > OPTIONS.aspect_tolerance


def _query_camera(focal_px: float, width: int, height: int, source: CameraSource) -> QueryCamera:
    try:
        return QueryCamera(ApproximateCamera(pinhole(width, height, focal_px)), source)
    except InvalidCameraError:
        # Tags that no lens has are as good as none.
        return QueryCamera(None, "search")
