"""Where a query's camera comes from, and what its numbers become."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.query.camera_sources import QueryCamera, camera_from_tags, focal_from_35mm, query_camera
from app.errors import InvalidCameraError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.focal import ApproximateCamera, pinhole
from app.vision.exif import PhotoTags

IPHONE = PhotoTags(make="Apple", model="iPhone 12", recorded_size=(4032, 3024))
# 26 mm on a 4:3 sensor by the diagonal.
MAIN_PX = 26 / 43.2666 * 5040


def approximate(found: QueryCamera) -> Camera:
    assert isinstance(found.camera, ApproximateCamera)
    return found.camera.camera


@pytest.mark.parametrize(
    ("tags", "source", "focal_px"),
    [
        (replace(IPHONE, focal_35mm=26.0), "exif", MAIN_PX),
        (replace(IPHONE, focal_35mm=52.0, digital_zoom=2.0), "exif", 2 * MAIN_PX),
        (replace(IPHONE, focal_35mm=26.0, digital_zoom=2.0), "exif", 2 * MAIN_PX),
        (replace(IPHONE, focal_mm=4.2), "exif", MAIN_PX),
        (replace(IPHONE, focal_mm=4.2, digital_zoom=1.5), "exif", 1.5 * MAIN_PX),
        (replace(IPHONE, focal_mm=4.2, plane_px_per_mm=720.0), "exif", 4.2 * 720),
        (IPHONE, "phone_database", MAIN_PX),
    ],
    ids=["35 mm", "zoom in it", "zoom not in it", "lens", "lens and zoom", "focal plane", "phone"],
)
def test_tags_tell_the_focal_length(tags: PhotoTags, source: str, focal_px: float) -> None:
    for width, height in ((4032, 3024), (3024, 4032), (1008, 756)):
        found = camera_from_tags(tags, width, height)
        camera = approximate(found)
        assert found.source == source
        assert camera.focal_px == pytest.approx(focal_px * max(width, height) / 4032, rel=1e-3)
        assert (camera.width, camera.height) == (width, height)


@pytest.mark.parametrize(
    "tags",
    [
        PhotoTags(),
        PhotoTags(make="Nobody", model="Brick", recorded_size=(4032, 3024)),
        PhotoTags(focal_mm=4.2),
        replace(IPHONE, focal_mm=1.54),
        replace(IPHONE, focal_35mm=26.0, recorded_size=(4032, 2000)),
        replace(IPHONE, focal_35mm=900.0),
        PhotoTags(focal_mm=4.2, plane_px_per_mm=1e8, recorded_size=(4032, 3024)),
        PhotoTags(focal_mm=4.2, plane_px_per_mm=1e-3, recorded_size=(4032, 3024)),
    ],
    ids=["none", "unknown phone", "no sensor", "another lens", "cut", "telescope", "huge", "tiny"],
)
def test_tags_that_do_not_tell_it_leave_a_search(tags: PhotoTags) -> None:
    assert camera_from_tags(tags, 4032, 3024) == QueryCamera(None, "search")


def test_the_35_mm_equivalent_by_shape() -> None:
    # A camera's own shape, where diagonal and width agree: 36 mm is the width.
    assert focal_from_35mm(36.0, 6000, 4000) == pytest.approx(6000)
    # A phone's picture cut to 16:9 or to a square sees as far along the side that was kept.
    assert focal_from_35mm(26.0, 4032, 2268) == pytest.approx(MAIN_PX, rel=1e-3)
    assert focal_from_35mm(26.0, 3024, 3024) == pytest.approx(MAIN_PX, rel=1e-3)


def test_what_was_used_in_the_end_decides_the_source() -> None:
    found = QueryCamera(ApproximateCamera(pinhole(640, 480, 500.0)), "exif")
    assert found.source_of(pinhole(640, 480, 470.0)) == "exif"
    assert found.source_of(pinhole(640, 480, 700.0)) == "search"
    assert found.source_of(None) == "unknown"
    assert QueryCamera(None, "search").source_of(pinhole(640, 480, 700.0)) == "search"
    assert QueryCamera(pinhole(640, 480, 700.0), "request").source_of(pinhole(640, 480, 700.0)) == "request"


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ((500.0, 500.0, 700.0, 240.0), "principal point"),
        ((500.0, 500.0, 320.0, -5.0), "principal point"),
        ((80.0, 80.0, 320.0, 240.0), "5 and 150 degrees"),
        ((8000.0, 8000.0, 320.0, 240.0), "5 and 150 degrees"),
        ((300.0, 700.0, 320.0, 240.0), "factor of two"),
        (Camera("PINHOLE", 1920, 1080, (1500.0, 1500.0, 960.0, 540.0)), "another aspect ratio"),
        (Camera("PINHOLE", 480, 640, (500.0, 500.0, 240.0, 320.0)), "EXIF orientation"),
    ],
)
def test_a_camera_that_can_not_be_the_images_own(camera: Camera | tuple[float, ...], words: str) -> None:
    hint = hint_of(camera) if isinstance(camera, Camera) else CameraHint(values=camera)
    with pytest.raises(InvalidCameraError, match=words):
        query_camera(hint, np.zeros((480, 640, 3), np.uint8), b"")
