"""Colour images of a scan: every format that cameras write, and none that would be turned when it is decoded."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from app.engine.mapping.frame_images import frame_rgb
from app.errors import InvalidScanError
from app.importers.registry import open_scan
from app.vision.images import decode_image
from tests.importers.scans import HEIGHT, WIDTH, write_tum

ORIENTATION = 0x0112
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:tiff="http://ns.adobe.com/tiff/1.0/" tiff:Orientation="{}"/></rdf:RDF></x:xmpmeta>'
)


def picture() -> Image.Image:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return Image.fromarray(np.stack([u * 4, v * 5, u + v], -1).astype(np.uint8))


def file_of(kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    picture().save(buffer, kind, **options)
    return buffer.getvalue()


def exif_of(orientation: int) -> bytes:
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    return exif.tobytes()


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_with(kind: bytes, content: bytes, behind: bool) -> bytes:
    """Return a PNG with one more chunk before its pixels or behind them."""
    whole = file_of("PNG")
    at = len(whole) - 12 if behind else whole.index(b"IDAT") - 4
    return whole[:at] + chunk(kind, content) + whole[at:]


def xmp_chunk(orientation: int) -> bytes:
    return b"XML:com.adobe.xmp\0\0\0\0\0" + XMP.format(orientation).encode()


def raw_profile(orientation: int) -> bytes:
    data = exif_of(orientation)
    return b"Raw profile type exif\0\nexif\n" + f"{len(data):8}\n{data.hex()}\n".encode()


TURNED: dict[str, Callable[[int], bytes]] = {
    "JPEG": lambda o: file_of("JPEG", exif=exif_of(o)),
    "JPEG XMP": lambda o: file_of("JPEG", xmp=XMP.format(o).encode()),
    "PNG": lambda o: file_of("PNG", exif=exif_of(o)),
    "PNG behind": lambda o: png_with(b"eXIf", exif_of(o).removeprefix(b"Exif\0\0"), behind=True),
    "PNG XMP": lambda o: png_with(b"iTXt", xmp_chunk(o), behind=False),
    "PNG XMP behind": lambda o: png_with(b"iTXt", xmp_chunk(o), behind=True),
    "PNG profile": lambda o: png_with(b"tEXt", raw_profile(o), behind=False),
    "PNG profile behind": lambda o: png_with(b"tEXt", raw_profile(o), behind=True),
    "WebP": lambda o: file_of("WEBP", exif=exif_of(o), lossless=True),
    "TIFF": lambda o: file_of("TIFF", exif=exif_of(o)),
    "HEIC": lambda o: file_of("HEIF", exif=exif_of(o), quality=95),
    "AVIF": lambda o: file_of("AVIF", exif=exif_of(o), quality=95),
}


def scan_with(folder: Path, data: bytes) -> Path:
    """Write a TUM scan whose one colour image is these bytes."""
    write_tum(folder, [0.0])
    (folder / "rgb/0.000000.png").write_bytes(data)
    return folder


@pytest.mark.parametrize("kind", TURNED)
def test_what_is_turned_is_refused_and_what_is_not_is_read(tmp_path: Path, kind: str) -> None:
    for orientation in (3, 6):
        with pytest.raises(InvalidScanError, match=r"0\.000000\.png has an EXIF rotation \(orientation \d\)"):
            open_scan(scan_with(tmp_path, TURNED[kind](orientation)))
    scan = open_scan(scan_with(tmp_path, TURNED[kind](1)))
    rgb = frame_rgb(scan, scan.frames[0])
    assert np.abs(rgb.astype(int) - np.asarray(picture())).mean() < 4


@pytest.mark.parametrize("kind", TURNED)
def test_queries_are_turned_by_what_scans_are_refused_for(kind: str) -> None:
    """The same data decide for both: a photo comes out upright as its file says."""
    upright, turned = decode_image(TURNED[kind](1)), decode_image(TURNED[kind](3))
    assert np.abs(upright[::-1, ::-1].astype(int) - turned).mean() < 4
    assert decode_image(TURNED[kind](6)).shape == (WIDTH, HEIGHT, 3)


def test_a_heic_file_turned_by_its_boxes_alone_is_refused(tmp_path: Path) -> None:
    data = TURNED["HEIC"](3)
    at = data.index(exif_of(3).removeprefix(b"Exif\0\0"))
    # The tag's value is made 1; the quarter turns of the box stay.
    without = data.replace(exif_of(3).removeprefix(b"Exif\0\0"), exif_of(1).removeprefix(b"Exif\0\0"))
    assert at > 0
    with pytest.raises(InvalidScanError, match="EXIF rotation"):
        open_scan(scan_with(tmp_path, without))


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (file_of("GIF"), "a GIF image"),
        (file_of("BMP"), "a BMP image"),
        (file_of("PPM"), "a PNM image"),
        # The small preview with which raw photos begin.
        (file_of("TIFF", tiffinfo={254: 1}), "a raw photo"),
        (b"II\x2a\0\x10\0\0\0CR\x02\0" + bytes(60), "a raw photo"),
        (b"\0\0\0\x18ftypmp42" + bytes(60), "a video"),
    ],
)
def test_other_formats_are_named(tmp_path: Path, data: bytes, name: str) -> None:
    with pytest.raises(InvalidScanError, match=rf"0\.000000\.png .*{name}"):
        open_scan(scan_with(tmp_path, data))


@pytest.mark.parametrize("kind", ["TIFF", "WEBP", "JPEG"])
def test_sizes_are_refused_by_the_header(tmp_path: Path, kind: str) -> None:
    written, data = cv2.imencode(
        {"TIFF": ".tiff", "WEBP": ".webp", "JPEG": ".jpg"}[kind], np.zeros((8000, 8000), np.uint8)
    )
    assert written
    with pytest.raises(InvalidScanError, match="8000 x 8000 pixels; the limit is 50 megapixels"):
        open_scan(scan_with(tmp_path, data.tobytes()))
