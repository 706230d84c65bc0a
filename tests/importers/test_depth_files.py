"""Depth images in every format that tools write: read alike, or refused by name with what to send instead."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from app.errors import InvalidScanError
from app.importers.frames import Scan, ScanOptions
from app.importers.images.depth_files import read_depth, read_depth_header
from app.importers.registry import open_scan
from tests.importers.scans import HEIGHT, WIDTH, write_tum

Values = NDArray[np.generic]
# Millimetres of a slope, and two values that mean nothing.
MILLIMETRES = np.add.outer(np.arange(HEIGHT) * 20, np.arange(WIDTH) * 10 + 1000).astype(np.uint16)
MILLIMETRES[0, :2] = 0, 65535


def encoded(suffix: str, values: Values, *flags: int) -> bytes:
    written, data = cv2.imencode(suffix, values, list(flags))
    assert written
    return data.tobytes()


def tiff(values: Values, **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, "TIFF", **options)
    return buffer.getvalue()


def npy(values: Values) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


def metres() -> NDArray[np.float32]:
    depth = MILLIMETRES.astype(np.float32) / 1000
    depth[0, :2] = np.nan, np.inf
    return depth


def scan_of(folder: Path, suffix: str, data: bytes, scale: float | None = 1000) -> Scan:
    """Return a TUM scan of one frame whose depth is in a file of these bytes."""
    write_tum(folder, [0.0])
    (folder / "depth/0.000000.png").unlink()
    (folder / f"depth/0{suffix}").write_bytes(data)
    (folder / "depth.txt").write_text(f"0.0 depth/0{suffix}\n")
    return open_scan(folder, "tum", ScanOptions(depth_scale=scale))


INTEGERS: list[tuple[str, Callable[[], bytes]]] = [
    (".png", lambda: encoded(".png", MILLIMETRES)),
    (".pgm", lambda: encoded(".pgm", MILLIMETRES)),
    (".tiff", lambda: tiff(MILLIMETRES)),
    (".tif", lambda: tiff(MILLIMETRES, compression="tiff_lzw")),
    (".npy", lambda: npy(MILLIMETRES)),
    (".npy", lambda: npy(np.asfortranarray(MILLIMETRES))),
    (".npy", lambda: npy(MILLIMETRES[..., None])),
]


@pytest.mark.parametrize(("suffix", "data"), INTEGERS, ids=[f"{i}{s}" for i, (s, _) in enumerate(INTEGERS)])
def test_16_bits_in_every_container(tmp_path: Path, suffix: str, data: Callable[[], bytes]) -> None:
    scan = scan_of(tmp_path, suffix, data())
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m[0, :2].tolist() == [0, 0]
    np.testing.assert_array_equal(depth_m[1:], (MILLIMETRES.astype(np.float32) / 1000)[1:])


@pytest.mark.parametrize("dtype", ["int32", "int16", "uint32", "int64", ">u2"])
def test_other_integers(tmp_path: Path, dtype: str) -> None:
    values = np.minimum(MILLIMETRES, 3000).astype(dtype)
    values[0, :2] = 0, -1 if np.dtype(dtype).kind == "i" else 0
    scan = scan_of(tmp_path, ".npy", npy(values))
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m[0, :2].tolist() == [0, 0]
    assert depth_m[1, 1] == np.float32(1.03)


FLOATS: list[tuple[str, Callable[[Values], bytes]]] = [
    (".tiff", tiff),
    (".tiff", lambda v: tiff(v, compression="tiff_adobe_deflate")),
    (".tiff", lambda v: encoded(".tiff", v)),
    (".npy", npy),
    (".npy", lambda v: npy(v.astype(np.float64))),
]


@pytest.mark.parametrize(("suffix", "write"), FLOATS, ids=[f"{i}{s}" for i, (s, _) in enumerate(FLOATS)])
@pytest.mark.parametrize("scale", [None, 1000.0, 5000.0, 1.0])
def test_floats_are_metres_whatever_scale_is_stated_for_integers(
    tmp_path: Path, suffix: str, write: Callable[[Values], bytes], scale: float | None
) -> None:
    scan = scan_of(tmp_path, suffix, write(metres()), scale)
    depth_m = scan.depth_m(scan.frames[0])
    assert depth_m[0, :2].tolist() == [0, 0]
    np.testing.assert_array_equal(depth_m[1:], metres()[1:])
    assert scan.notes == (() if scale == 1.0 else ("The depth images hold floats, read as metres.",))


def test_floats_in_millimetres_and_in_nothing_known(tmp_path: Path) -> None:
    scan = scan_of(tmp_path / "mm", ".tiff", tiff(metres() * 1000), None)
    np.testing.assert_allclose(scan.depth_m(scan.frames[0])[1:], metres()[1:], rtol=1e-6)
    assert scan.notes == ("The depth images hold floats, read as millimetres.",)
    with pytest.raises(InvalidScanError, match=r"0\.tiff holds floats whose median is 1.* Give depth_scale"):
        scan_of(tmp_path / "um", ".tiff", tiff(metres() * 1e6), None)
    scan = scan_of(tmp_path / "stated", ".tiff", tiff(metres() * 1e6), 1e6)
    np.testing.assert_allclose(scan.depth_m(scan.frames[0])[1:], metres()[1:], rtol=1e-6)


@pytest.mark.parametrize("compression", [0, 1, 2, 3])
@pytest.mark.parametrize(("kind", "tolerance"), [(1, 2e-3), (2, 0.0)])
def test_openexr(monkeypatch: pytest.MonkeyPatch, compression: int, kind: int, tolerance: float) -> None:
    """OpenCV's writer, which it leaves off, against our reader: half and single floats, all compressions read."""
    monkeypatch.setenv("OPENCV_IO_ENABLE_OPENEXR", "1")
    depth = metres()
    for values in (depth, np.dstack([depth] * 3)):
        flags = (cv2.IMWRITE_EXR_TYPE, kind, cv2.IMWRITE_EXR_COMPRESSION, compression)
        found = read_depth(encoded(".exr", values, *flags), "a.exr")
        assert np.isnan(found[0, 0])
        np.testing.assert_allclose(found[1:].astype(np.float64), depth[1:], atol=tolerance)
    with pytest.raises(
        InvalidScanError, match=r"a\.exr is an OpenEXR image with PIZ compression; save it with ZIP"
    ):
        read_depth(encoded(".exr", depth, cv2.IMWRITE_EXR_COMPRESSION, 4), "a.exr")


EIGHT_BITS = (MILLIMETRES >> 8).astype(np.uint8)
REFUSED: list[tuple[str, Callable[[], bytes], str]] = [
    (".png", lambda: encoded(".png", EIGHT_BITS), "one channel of 16 bits .* it has one channel and 8 bits"),
    (".png", lambda: encoded(".png", np.dstack([MILLIMETRES] * 3)), "it has colour, .* and 16 bits"),
    (".tiff", lambda: tiff(EIGHT_BITS), "a TIFF with one channel of 16 or 32 bits"),
    (".pgm", lambda: encoded(".pgm", EIGHT_BITS), "a PGM of 16 bits .* its largest value is 255"),
    (".pgm", lambda: b"P2 4 2 65535\n1 2 3 4 5 6 7 8\n", "written as text"),
    (
        ".jpg",
        lambda: encoded(".jpg", EIGHT_BITS),
        "a picture in a format for photos, which is not read as depth",
    ),
    (".webp", lambda: encoded(".webp", EIGHT_BITS), "a picture in a format for photos"),
    (".bmp", lambda: encoded(".bmp", EIGHT_BITS), "a BMP image"),
    (".npy", lambda: npy(EIGHT_BITS), r"an array of shape \(48, 64\) and type uint8"),
    (".npy", lambda: npy(np.zeros((3, 4, 5))), r"an array of shape \(3, 4, 5\)"),
    (".npz", lambda: b"PK\x03\x04" + bytes(50), "a NumPy archive"),
]


@pytest.mark.parametrize(("suffix", "data", "message"), REFUSED, ids=range(len(REFUSED)))
def test_what_holds_no_depth_is_named(
    tmp_path: Path, suffix: str, data: Callable[[], bytes], message: str
) -> None:
    with pytest.raises(InvalidScanError, match=rf"0\{suffix} .*{message}"):
        scan_of(tmp_path, suffix, data())


def test_an_unknown_kind_is_unreadable_and_named(tmp_path: Path) -> None:
    with pytest.raises(
        InvalidScanError, match=r"The first unreadable file: 0\.bin of frame .*, empty, damaged"
    ):
        scan_of(tmp_path, ".bin", bytes(range(256)))


def with_size(data: bytes, width: int, height: int) -> bytes:
    """Return a TIFF whose tags state another size."""
    out = bytearray(data)
    start = int.from_bytes(out[4:8], "little")
    for i in range(int.from_bytes(out[start : start + 2], "little")):
        at = start + 2 + 12 * i
        tag = int.from_bytes(out[at : at + 2], "little")
        if tag in (256, 257):
            out[at + 2 : at + 4] = (4).to_bytes(2, "little")
            out[at + 8 : at + 12] = (width if tag == 256 else height).to_bytes(4, "little")
    return bytes(out)


@pytest.mark.parametrize(
    ("suffix", "data"),
    [
        (".tiff", lambda: with_size(tiff(MILLIMETRES), 9000, 9000)),
        (".tiff", lambda: with_size(tiff(MILLIMETRES), 90_000, 90_000)),
        (".pgm", lambda: b"P5 40000 40000 65535\n" + bytes(100)),
        (".npy", lambda: npy(MILLIMETRES).replace(b"(48, 64), }  ", b"(48000,64000)}")),
    ],
    ids=range(4),
)
def test_sizes_are_refused_before_anything_is_decoded(
    tmp_path: Path, suffix: str, data: Callable[[], bytes]
) -> None:
    path = tmp_path / f"0{suffix}"
    path.write_bytes(data())
    with pytest.raises(InvalidScanError, match="the limit is 50 megapixels"):
        read_depth_header(path)
    with pytest.raises(InvalidScanError):
        read_depth(path.read_bytes(), path.name)


def test_damaged_files_never_raise_anything_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENCV_IO_ENABLE_OPENEXR", "1")
    rng = np.random.default_rng(0)
    files = [encoded(".png", MILLIMETRES), encoded(".pgm", MILLIMETRES), tiff(metres()), npy(MILLIMETRES)]
    files += [encoded(".exr", metres(), cv2.IMWRITE_EXR_COMPRESSION, c) for c in (0, 1, 3)]
    outcomes = set()
    for whole in files:
        for trial in range(80):
            damaged = bytearray(whole if trial % 2 else whole[: int(rng.integers(4, len(whole)))])
            for at in rng.integers(0, min(len(damaged), 400 if trial % 4 else len(damaged)), 3):
                damaged[at] = int(rng.integers(256))
            try:
                assert read_depth(bytes(damaged), "depth").ndim == 2
                outcomes.add("read")
            except InvalidScanError:
                outcomes.add("refused")
    assert outcomes == {"read", "refused"}
