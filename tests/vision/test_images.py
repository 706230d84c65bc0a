"""Decoding of every kind of picture phones and tools send, and the measures of a picture's quality."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from app.errors import ImageTooLargeError, InvalidImageError, UnsupportedImageError
from app.vision.images import OPTIONS, decode_image, measure_quality, shrink, to_gray

ORIENTATION = 0x0112


def picture(width: int = 96, height: int = 64) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return a smooth picture without any symmetry, which JPEG keeps well."""
    v, u = np.mgrid[:height, :width]
    return np.stack(
        [u * 255 // width, v * 255 // height, (u + 2 * v) * 255 // (width + 2 * height)], -1
    ).astype(np.uint8)


def file_of(image: Image.Image, kind: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("kind", "options", "tolerance"),
    [
        ("PNG", {}, 0),
        ("WEBP", {"lossless": True}, 0),
        ("WEBP", {"quality": 95}, 8),
        ("JPEG", {"quality": 97}, 8),
    ],
)
def test_the_usual_formats(kind: str, options: dict[str, Any], tolerance: int) -> None:
    rgb = decode_image(file_of(Image.fromarray(picture()), kind, **options))
    assert rgb.dtype == np.uint8
    assert np.abs(rgb.astype(int) - picture()).max() <= tolerance


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_exif_orientation_is_undone(kind: str, orientation: int) -> None:
    # How each orientation stores a picture: what undoes the turn or mirroring that it asks for.
    store = {
        1: lambda a: a,
        2: lambda a: a[:, ::-1],
        3: lambda a: a[::-1, ::-1],
        4: lambda a: a[::-1],
        5: lambda a: a.transpose(1, 0, 2),
        6: np.rot90,
        7: lambda a: a[::-1, ::-1].transpose(1, 0, 2),
        8: lambda a: np.rot90(a, -1),
    }
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    stored = Image.fromarray(np.ascontiguousarray(store[orientation](picture())))
    options = {"quality": 97} if kind != "PNG" else {}
    rgb = decode_image(file_of(stored, kind, exif=exif, **options))
    assert rgb.shape == picture().shape
    assert np.abs(rgb.astype(int) - picture()).mean() < 3


@pytest.mark.parametrize(
    "exif", [b"Exif\0\0garbage", b"Exif\0\0MM\0*\0\0\0\x08\xff\xff", b"Exif\0\0II*\0\xff\xff\xff\xff"]
)
def test_damaged_exif_does_no_harm(exif: bytes) -> None:
    rgb = decode_image(file_of(Image.fromarray(picture()), "JPEG", quality=97, exif=exif))
    assert rgb.shape == picture().shape


def test_gray_pictures_of_8_and_16_bits() -> None:
    gray = picture()[..., 2]
    for image in (gray, gray.astype(np.uint16) * 257):
        written, data = cv2.imencode(".png", image)
        assert written
        rgb = decode_image(data.tobytes())
        assert np.array_equal(rgb, np.repeat(gray[..., None], 3, axis=2))
    bits = decode_image(file_of(Image.fromarray(gray > 128), "PNG"))
    assert np.array_equal(bits[..., 0], (gray > 128) * 255)


def test_colour_of_16_bits() -> None:
    written, data = cv2.imencode(".png", picture()[..., ::-1].astype(np.uint16) * 257)
    assert written
    assert np.abs(decode_image(data.tobytes()).astype(int) - picture()).max() <= 1


def test_cmyk_jpeg() -> None:
    rgb = decode_image(file_of(Image.fromarray(picture()).convert("CMYK"), "JPEG", quality=97))
    assert np.abs(rgb.astype(int) - picture()).mean() < 5


def test_palette_and_transparency() -> None:
    palette = Image.fromarray(picture()).quantize(64)
    expected = np.asarray(palette.convert("RGB"))
    assert np.array_equal(decode_image(file_of(palette, "PNG", transparency=0)), expected)
    alpha = np.dstack([picture(), picture()[..., 0]])
    assert np.array_equal(decode_image(file_of(Image.fromarray(alpha), "PNG")), picture())
    gray_alpha = Image.fromarray(picture()).convert("LA")
    assert decode_image(file_of(gray_alpha, "PNG")).shape == picture().shape


@pytest.mark.parametrize("kind", ["GIF", "BMP", "TIFF", "PPM"])
def test_other_formats_are_refused(kind: str) -> None:
    with pytest.raises(UnsupportedImageError):
        decode_image(file_of(Image.fromarray(picture()), kind))


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_a_picture_cut_short_anywhere_is_refused(kind: str) -> None:
    whole = file_of(Image.fromarray(picture()), kind)
    for length in range(0, len(whole) - 20, max(1, len(whole) // 60)):
        with pytest.raises(InvalidImageError):
            decode_image(whole[:length])


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_damaged_bytes_never_raise_anything_else(kind: str) -> None:
    whole = bytearray(file_of(Image.fromarray(picture()), kind))
    rng = np.random.default_rng(0)
    for _ in range(150):
        damaged = whole.copy()
        for at in rng.integers(0, len(whole), 4):
            damaged[at] = rng.integers(0, 256)
        try:
            rgb = decode_image(bytes(damaged))
        except InvalidImageError:
            continue
        assert rgb.ndim == 3


def test_a_png_with_a_huge_comment_is_refused() -> None:
    whole = file_of(Image.fromarray(picture()), "PNG")
    text = b"zTXt" + b"c\0\0" + zlib.compress(bytes(100_000_000))
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    with pytest.raises(InvalidImageError):
        decode_image(whole[:33] + chunk + whole[33:])


def test_size_limits_hold_before_decoding() -> None:
    data = file_of(Image.fromarray(picture(96, 64)), "PNG")
    with pytest.raises(ImageTooLargeError, match="96 x 64"):
        decode_image(data, max_pixels=6000)
    assert decode_image(data, max_pixels=96 * 64).shape == (64, 96, 3)
    for width, height in ((31, 64), (64, 31), (32 * int(OPTIONS.max_aspect_ratio) + 1, 32)):
        with pytest.raises(InvalidImageError):
            decode_image(file_of(Image.fromarray(picture(width, height)), "PNG"))


def test_shrinking_keeps_points_where_the_convention_says() -> None:
    dots = np.zeros((400, 800), np.uint8)
    at = np.array([[200.0, 100.0], [601.0, 299.0]])
    for u, v in at.astype(int):
        dots[v - 3 : v + 4, u - 3 : u + 4] = 255
    small, scale = shrink(dots, 200)
    assert (small.shape, scale) == ((100, 200), 0.25)
    _, _, _, centres = cv2.connectedComponentsWithStats((small > 20).astype(np.uint8))
    assert np.allclose((centres[1:] + 0.5) / scale - 0.5, at, atol=1.0)
    assert shrink(dots, 800)[0] is dots


def test_quality_tells_poor_blurred_and_good_pictures_apart() -> None:
    rng = np.random.default_rng(0)
    good = cv2.resize(
        rng.integers(0, 256, (60, 80), dtype=np.uint8), (640, 480), interpolation=cv2.INTER_NEAREST
    )
    blurred = cv2.GaussianBlur(good, (0, 0), 6)
    assert measure_quality(np.asarray(blurred, np.uint8)).sharpness < 0.2 * measure_quality(good).sharpness
    assert not measure_quality(good).is_poor
    for value in (0, 128, 255):
        assert measure_quality(np.full((480, 640), value, np.uint8)).is_poor
    dim = measure_quality((good // 2).astype(np.uint8))
    assert dim.sharpness == pytest.approx(measure_quality(good).sharpness, rel=0.1)
    assert to_gray(picture()).shape == (64, 96)
