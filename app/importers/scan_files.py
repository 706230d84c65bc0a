"""Reading the small files of a scan: lists, camera, gravity and image headers, all inside one directory."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from app.errors import InvalidCameraError, InvalidScanError
from app.geometry.camera import MODEL_PARAMETERS, Camera

# An hour of poses at 100 Hz is 30 MB of text.
MAX_LIST_BYTES = 64 * 1024 * 1024
MAX_IMAGE_PIXELS = 50_000_000

_SEPARATORS = re.compile(r"[,;\s]+")
_DEPTH_SCALE = re.compile(r"depth_scale\s*[=:]\s*([0-9][0-9.eE+]*)")
_EXIF_ORIENTATION = 0x0112


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a list file that is no comment: its number, from 1, and its text without the ends."""

    line: int
    text: str

    def cells(self, max_cells: int = 0) -> list[str]:
        """Return the columns, split at blanks, tabs or commas; with `max_cells` the last keeps the rest."""
        return _SEPARATORS.split(self.text, maxsplit=max(0, max_cells - 1))


def resolve_inside(directory: Path, relative: str, where: str) -> Path:
    """Return the path of `relative` below `directory`, which need not exist.

    `where` names the place that says it, for the message. Raises `InvalidScanError` for absolute paths, `..`,
    control characters, and symbolic links that lead out of the directory.
    """
    name = relative.replace("\\", "/")
    if not name or name.startswith("/") or re.match(r"[A-Za-z]:", name) or ".." in name.split("/"):
        raise InvalidScanError(f"{where}: the path {relative!r} must lie inside the scan's folder.")
    if any(ord(c) < 32 or ord(c) == 127 for c in name) or len(name) > 1000:
        raise InvalidScanError(f"{where}: {relative[:60]!r} is not a file name that can be used.")
    path = directory / name
    try:
        inside = path.resolve().is_relative_to(directory.resolve())
    except (OSError, RuntimeError):
        inside = False
    if not inside:
        raise InvalidScanError(f"{where}: the path {relative!r} is a link that leaves the scan's folder.")
    return path


def optional_file(directory: Path, name: str) -> Path | None:
    """Return the file `name` of the scan, or None where there is none."""
    path = resolve_inside(directory, name, name)
    return path if path.is_file() else None


def read_text(path: Path) -> str:
    """Return the text of a list file, whatever its byte-order mark; raises `InvalidScanError` past 64 MB."""
    if path.stat().st_size > MAX_LIST_BYTES:
        raise InvalidScanError(f"{path.name} is larger than {MAX_LIST_BYTES >> 20} MB, too large for a list.")
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    return data.decode("utf-8-sig", errors="replace")


def rows(text: str) -> Iterator[Row]:
    """Yield the lines that hold something: comments (`#`) and blank lines are left out."""
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.strip(" \t,;\ufeff\x00")
        if content and not content.startswith("#"):
            yield Row(number, content)


def numbers(cells: list[str], where: str) -> list[float]:
    """Return the cells as numbers, NaN and infinity among them; raises `InvalidScanError` naming `where`."""
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        raise InvalidScanError(f"{where}: {' '.join(cells)[:80]!r} must be numbers.") from None


@dataclass(frozen=True, slots=True)
class CameraFile:
    """What `camera.txt` states: a `Camera` or bare intrinsics (4, 8 or 9 numbers), maybe a depth scale."""

    camera: Camera | tuple[float, ...]
    depth_scale: float | None


def read_camera_file(directory: Path) -> CameraFile | None:
    """Return the contents of `camera.txt`, None where there is none.

    Its one row is `MODEL width height params...` (COLMAP's names and order) or `fx fy cx cy [k1 k2 p1 p2
    [k3]]`; a comment may state `depth_scale = N`, units per metre. Raises `InvalidScanError` for anything
    else.
    """
    path = optional_file(directory, "camera.txt")
    if path is None:
        return None
    text = read_text(path)
    lines = list(rows(text))
    if len(lines) != 1:
        raise InvalidScanError(
            f"camera.txt must hold one row, `MODEL width height params...`, not {len(lines)}."
        )
    scale = _DEPTH_SCALE.search(text)
    depth_scale = numbers([scale.group(1)], "camera.txt: depth_scale")[0] if scale else None
    if depth_scale is not None and not 0 < depth_scale < np.inf:
        raise InvalidScanError("camera.txt: depth_scale must be above 0, in units per metre.")
    return CameraFile(_camera_of_cells(lines[0].cells()), depth_scale)


def _camera_of_cells(cells: list[str]) -> Camera | tuple[float, ...]:
    if cells[0] not in MODEL_PARAMETERS:
        if re.match(r"[A-Za-z_]+$", cells[0]):
            known = ", ".join(MODEL_PARAMETERS)
            raise InvalidScanError(f"camera.txt: model {cells[0]!r} is not known; use one of {known}.")
        return tuple(numbers(cells, "camera.txt"))
    values = numbers(cells[1:], "camera.txt")
    if len(values) < 3 or any(not v.is_integer() for v in values[:2]):
        raise InvalidScanError(
            "camera.txt: after the model come width and height in whole pixels, then params."
        )
    try:
        return Camera(cells[0], int(values[0]), int(values[1]), tuple(values[2:]))
    except InvalidCameraError as error:
        raise InvalidScanError(f"camera.txt: {error}") from None


def read_gravity(directory: Path) -> tuple[float, float, float] | None:
    """Return the unit direction of down in the scan's frame from `gravity.txt`, None where there is none.

    Raises `InvalidScanError` for anything but one row of three finite numbers that are not all zero.
    """
    path = optional_file(directory, "gravity.txt")
    if path is None:
        return None
    lines = list(rows(read_text(path)))
    values = np.array(numbers(lines[0].cells(), "gravity.txt") if len(lines) == 1 else [])
    length = float(np.linalg.norm(values))
    if values.shape != (3,) or not 1e-6 < length < 1e6:
        raise InvalidScanError("gravity.txt must hold one row of three numbers, the direction of down.")
    x, y, z = (values / length).tolist()
    return x, y, z


def color_size(path: Path) -> tuple[int, int] | None:
    """Return (width, height) of a PNG or JPEG from its header, None if it can't be read.

    Raises `InvalidScanError` for more than 50 megapixels, and for an image that its EXIF data says to rotate:
    its pixels would no longer lie where the depth image and the camera have them.
    """
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as image:
            size = image.size
            # Asked for the EXIF data that it hasn't met in its header, a PNG is decoded to the end.
            has_exif = image.format == "JPEG" or "exif" in image.info
            orientation = image.getexif().get(_EXIF_ORIENTATION, 1) if has_exif else 1
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, ValueError, SyntaxError):
        return None
    if size[0] * size[1] > MAX_IMAGE_PIXELS:
        raise InvalidScanError(f"{path.name} has {size[0]} x {size[1]} pixels; the limit is 50 megapixels.")
    if orientation not in (0, 1):
        raise InvalidScanError(f"{path.name} has an EXIF rotation; save the scan's images without one.")
    return size


def depth_size(path: Path) -> tuple[int, int] | None:
    """Return (width, height) of a PNG depth image from its header, None if it is no PNG.

    Raises `InvalidScanError` for a PNG that does not hold one channel of 16 bits.
    """
    try:
        with path.open("rb") as file:
            header = file.read(26)
    except OSError:
        return None
    if len(header) < 26 or not header.startswith(b"\x89PNG\r\n\x1a\n") or header[12:16] != b"IHDR":
        return None
    if header[24] != 16 or header[25] != 0:
        raise InvalidScanError(f"{path.name} must be a PNG with one channel of 16 bits to be a depth image.")
    width, height = int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")
    if not 0 < width * height <= MAX_IMAGE_PIXELS:
        raise InvalidScanError(f"{path.name} has {width} x {height} pixels; the limit is 50 megapixels.")
    return width, height
