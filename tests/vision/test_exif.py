"""The tags of phone photos: read where they make sense, ignored where they don't, and never a reason to fail."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from app.vision.exif import (
    DIGITAL_ZOOM,
    EXIF_IFD,
    FOCAL_35MM,
    FOCAL_LENGTH,
    MAKE,
    MODEL,
    PIXEL_X,
    PIXEL_Y,
    PLANE_UNIT,
    PLANE_X_RESOLUTION,
    PhotoTags,
    read_photo_tags,
)
from app.vision.phone_cameras import find_phone, list_phones


def exif_of(base: dict[int, Any] | None = None, own: dict[int, Any] | None = None) -> Image.Exif:
    exif = Image.Exif()
    for tag, value in (base or {}).items():
        exif[tag] = value
    exif[EXIF_IFD] = dict(own or {})
    return exif


def photo(exif: Image.Exif | bytes, kind: str = "JPEG") -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (64, 48)).save(buffer, kind, exif=exif)
    return buffer.getvalue()


PHONE = {
    FOCAL_LENGTH: 4.2,
    FOCAL_35MM: 26,
    DIGITAL_ZOOM: 1.5,
    PIXEL_X: 4032,
    PIXEL_Y: 3024,
    PLANE_X_RESOLUTION: 720.0,
    PLANE_UNIT: 4,
}


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "HEIF", "AVIF"])
def test_the_tags_of_a_phone(kind: str) -> None:
    tags = read_photo_tags(photo(exif_of({MAKE: "Apple", MODEL: "iPhone 12\0"}, PHONE), kind))
    assert (tags.make, tags.model) == ("Apple", "iPhone 12")
    assert tags.focal_mm == pytest.approx(4.2)
    assert (tags.focal_35mm, tags.recorded_size) == (26, (4032, 3024))
    assert tags.digital_zoom == pytest.approx(1.5)
    assert tags.plane_px_per_mm == pytest.approx(720.0)


@pytest.mark.parametrize(
    ("unit", "factor"), [(2, 1 / 25.4), (3, 0.1), (4, 1.0), (5, 1000.0), (1, None), (9, None)]
)
def test_units_of_the_focal_plane(unit: int, factor: float | None) -> None:
    tags = read_photo_tags(photo(exif_of(own={PLANE_X_RESOLUTION: 500.0, PLANE_UNIT: unit})))
    assert tags.plane_px_per_mm == (None if factor is None else pytest.approx(500.0 * factor))


@pytest.mark.parametrize(
    "value", [0, 65535, IFDRational(0, 0), IFDRational(5, 0), IFDRational(0, 5), "wide", (1, 2, 3)], ids=str
)
def test_a_tag_that_can_not_be_is_missing(value: Any) -> None:
    for tag in (FOCAL_LENGTH, FOCAL_35MM, PLANE_X_RESOLUTION, DIGITAL_ZOOM):
        exif = exif_of()
        # Past Pillow's writer, which refuses some of these: what its reader would hand over.
        tags = _tags_with(exif, tag, value)
        assert tags.focal_mm is None
        assert tags.focal_35mm is None
        assert tags.digital_zoom == 1.0


def _tags_with(exif: Image.Exif, tag: int, value: Any) -> PhotoTags:
    from app.vision import exif as module

    return module._tags(exif, {tag: value})


def test_no_tags_or_no_image() -> None:
    assert read_photo_tags(photo(b"")) == PhotoTags()
    for data in (b"", b"GIF89a", b"\xff\xd8\xff", bytes(1000)):
        assert read_photo_tags(data) == PhotoTags()


def test_damaged_tags_are_ignored() -> None:
    rng = np.random.default_rng(0)
    good = exif_of({MAKE: "Apple", MODEL: "iPhone 12"}, PHONE).tobytes()
    for _ in range(400):
        damaged = bytearray(good)
        for place in rng.integers(6, len(good), rng.integers(1, 12)):
            damaged[place] = int(rng.integers(256))
        cut = len(good) if rng.random() < 0.7 else int(rng.integers(1, len(good)))
        tags = read_photo_tags(photo(bytes(damaged[:cut])))
        for value in (tags.focal_mm, tags.focal_35mm, tags.plane_px_per_mm, tags.digital_zoom):
            assert value is None or (np.isfinite(value) and value > 0)
        assert len(tags.make) <= 64
    assert read_photo_tags(photo(b"Exif\0\0" + rng.bytes(500))) == PhotoTags()


def test_phones_are_found_by_their_names() -> None:
    phone = find_phone("Apple", "iPhone 12")
    assert phone is not None
    assert (phone.focal_mm, phone.focal_35mm) == (4.2, 26)
    samsung = find_phone("samsung", "SM-G991B")
    assert samsung is not None
    assert samsung.focal_35mm == 26
    assert find_phone("SAMSUNG", "sm-g991u1") == samsung
    for make, model in (
        ("Apple", "iPhone 1"),
        ("", ""),
        ("Google", "SM-G991B"),
        ("Apple", "iPhone 12 Ultra"),
    ):
        assert find_phone(make, model) is None


def test_the_list_of_phones_holds_what_phones_have() -> None:
    phones = list_phones()
    assert len(phones) >= 60
    assert all(20 <= phone.focal_35mm <= 36 for phone in phones)
    assert all(phone.focal_mm is None or 3 <= phone.focal_mm <= 10 for phone in phones)
