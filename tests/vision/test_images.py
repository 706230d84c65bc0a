"""Decoding of every kind of picture phones and tools send, and the measures of a picture's quality."""

from __future__ import annotations

import base64
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
        ("HEIF", {"quality": 98}, 16),
        ("AVIF", {"quality": 98}, 16),
        ("TIFF", {}, 0),
        ("TIFF", {"compression": "tiff_lzw"}, 0),
        ("TIFF", {"compression": "jpeg"}, 40),
    ],
)
def test_the_usual_formats(kind: str, options: dict[str, Any], tolerance: int) -> None:
    rgb = decode_image(file_of(Image.fromarray(picture()), kind, **options))
    assert rgb.dtype == np.uint8
    assert np.abs(rgb.astype(int) - picture()).max() <= tolerance


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "HEIF", "AVIF", "TIFF"])
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
    options = {"quality": 97} if kind not in ("PNG", "TIFF") else {}
    # As bytes: for HEIF, the writer turns what they say into the boxes that turn a picture.
    rgb = decode_image(file_of(stored, kind, exif=exif.tobytes(), **options))
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


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_sensors_of_fewer_bits_in_16(kind: str, bits: int) -> None:
    """The brightest value says how many bits were used: the picture is as bright as one of 8 bits."""
    gray = picture()[..., 2].astype(np.uint16)
    deep = (gray << (bits - 8)) + (gray >> (16 - bits))
    deep[0, 0] = 2**bits - 1
    found = decode_image(file_of(Image.fromarray(deep.astype(np.uint16)), kind))
    assert np.abs(found[..., 0].astype(int) - gray)[1:].max() <= 1


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_colour_of_12_bits_in_16_turned_as_it_says(orientation: int) -> None:
    deep = picture()[..., ::-1].astype(np.uint16) << 4
    written, data = cv2.imencode(".png", deep)
    assert written
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    content = exif.tobytes().removeprefix(b"Exif\0\0")
    chunk = (
        struct.pack(">I", len(content)) + b"eXIf" + content + struct.pack(">I", zlib.crc32(b"eXIf" + content))
    )
    whole = data.tobytes()
    upright = {1: picture(), 3: picture()[::-1, ::-1], 6: np.rot90(picture(), -1)}[orientation]
    # Before the pixels and behind them.
    for at in (33, len(whole) - 12):
        found = decode_image(whole[:at] + chunk + whole[at:])
        assert found.shape == upright.shape
        assert np.abs(found.astype(int) - upright).max() <= 1


def test_floats_and_wide_integers() -> None:
    gray = picture()[..., 2]
    for values in (gray.astype(np.float32) / 255, gray.astype(np.float32), gray.astype(np.int32) * 257):
        found = decode_image(file_of(Image.fromarray(values), "TIFF"))
        assert np.abs(found[..., 0].astype(int) - gray).max() <= 1
    odd = gray.astype(np.float32)
    odd[0, :3] = np.nan, np.inf, -5
    assert decode_image(file_of(Image.fromarray(odd), "TIFF"))[0, :3].max() == 0


@pytest.mark.parametrize(
    ("kind", "name"), [("GIF", "a GIF image"), ("BMP", "a BMP image"), ("PPM", "a PNM image")]
)
def test_other_formats_are_refused_by_name(kind: str, name: str) -> None:
    with pytest.raises(
        UnsupportedImageError, match=f"The file is {name}.*; send JPEG, PNG, WebP, HEIC, AVIF or TIFF"
    ):
        decode_image(file_of(Image.fromarray(picture()), kind))


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"%PDF-1.7" + bytes(100), "a PDF file"),
        (b"\x00\x00\x00 ftypisom" + bytes(100), "a video"),
        (b"II\x2a\0\x10\0\0\0CR\x02\0" + bytes(100), "a raw photo"),
        (file_of(Image.fromarray(picture()), "TIFF", tiffinfo={254: 1}), "a raw photo"),
        (b"\xff\x0a" + bytes(100), "a JPEG XL image"),
        (b"PK\x03\x04" + bytes(100), "an archive"),
        (b"<svg>" + bytes(100), "a text file"),
        *[
            (base64.b64encode(file_of(Image.fromarray(picture()), kind)), "a picture as base64 text")
            for kind in ("JPEG", "PNG", "WEBP", "HEIF")
        ],
        (b"data:image/jpeg;base64,/9j/4AAQ", "a picture as base64 text"),
        *[
            (
                file_of(Image.fromarray(picture()), kind).decode(*how).encode(),
                "a picture that was read as text",
            )
            for kind in ("JPEG", "PNG")
            for how in (("utf-8", "replace"), ("latin-1",))
        ],
        (b"[object Object]", "text"),
        (b"/sdcard/DCIM/photo.jpg", "text"),
        (b"x" * 1000, "text"),
        (
            file_of(
                Image.fromarray(picture()), "AVIF", save_all=True, append_images=[Image.fromarray(picture())]
            ),
            "an animated AVIF",
        ),
    ],
)
def test_what_is_sent_by_mistake_is_named(data: bytes, name: str) -> None:
    with pytest.raises(UnsupportedImageError, match=f"The file is {name}"):
        decode_image(data)


@pytest.mark.parametrize(("kind", "name"), [("PNG", "PNG"), ("JPEG", "JPEG"), ("WEBP", "WebP")])
def test_what_is_left_of_a_header_is_damaged_and_no_other_format(kind: str, name: str) -> None:
    with pytest.raises(InvalidImageError, match=f"begins like {name}|damaged or cut short"):
        decode_image(file_of(Image.fromarray(picture()), kind)[:20])


def test_a_tiff_of_another_kind_is_a_tiff() -> None:
    colours = cv2.imencode(".tif", (picture() / 255).astype(np.float32))[1].tobytes()
    with pytest.raises(UnsupportedImageError, match="a TIFF of a kind that is not read"):
        decode_image(colours)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "HEIF", "AVIF", "TIFF"])
def test_a_picture_cut_short_anywhere_is_refused(kind: str) -> None:
    whole = file_of(Image.fromarray(picture()), kind)
    for length in range(0, len(whole) - 20, max(1, len(whole) // 60)):
        with pytest.raises(InvalidImageError):
            decode_image(whole[:length])


@pytest.mark.parametrize("kind", ["HEIF", "AVIF"])
def test_a_picture_larger_than_its_header_says_is_not_decoded(kind: str) -> None:
    """The size that was checked is the size that is decoded, not that of the compressed pictures inside."""
    whole = bytearray(file_of(Image.new("RGB", (3000, 2000)), kind, quality=20))
    at = 0
    while (at := whole.find(b"ispe", at) + 1) > 0:
        whole[at + 7 : at + 15] = struct.pack(">II", 64, 64)
    with pytest.raises(InvalidImageError):
        decode_image(bytes(whole), max_pixels=64 * 64)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "HEIF", "AVIF", "TIFF"])
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
