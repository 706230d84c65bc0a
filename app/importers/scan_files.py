"""Reading the small files of a scan: lists, camera, gravity and image headers, all inside one directory."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.errors import InvalidInputError, InvalidScanError
from app.geometry.camera import MODEL_PARAMETERS
from app.geometry.camera_hint import SIMPLE_MODELS, CameraHint, parse_camera_hint
from app.limits import limit

MIB = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class ListLimits:
    """How large the small files of a scan may be."""

    max_list_bytes: int = limit(
        64 * MIB,
        "Bytes of a list, a camera file or a trajectory.",
        chosen="By hand: an hour of poses at 100 Hz is 30 MB of text.",
    )
    max_path_characters: int = limit(
        1000, "Characters of a path in a list.", chosen="By hand: past what archives are unpacked to."
    )


LIMITS = ListLimits()

_SEPARATORS = re.compile(r"[,;\s]+")
_BLANKS = re.compile(r"[;\s]+")
_DECIMAL_COMMA = re.compile(
    r"[-+]?(?:\d+(?:,\d+)?|,\d+)(?:[eE][-+]?\d+)?$|[-+]?(?:nan|inf|infinity)$", re.IGNORECASE
)
_DEPTH_SCALE = re.compile(r"depth_scale\s*[=:]\s*([0-9][0-9.eE+]*)")


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a list file that is no comment: its number, from 1, and its text without the ends."""

    line: int
    text: str

    def cells(self) -> list[str]:
        """Return the columns, split at blanks, tabs, commas or semicolons.

        Where blanks or semicolons stand between numbers and every comma is inside of one, the commas are decimal
        commas; they become points.
        """
        apart = _BLANKS.split(self.text)
        if len(apart) > 1 and "," in self.text and all(_DECIMAL_COMMA.match(cell) for cell in apart):
            return [cell.replace(",", ".") for cell in apart]
        return _SEPARATORS.split(self.text)


def resolve_inside(directory: Path, relative: str, where: str) -> Path:
    """Return the path of `relative` below `directory`, which need not exist.

    `where` names the place that says it, for the message. Raises `InvalidScanError` for absolute paths, `..`,
    control characters, and symbolic links that lead out of the directory.
    """
    name = relative.replace("\\", "/")
    if not name or name.startswith("/") or re.match(r"[A-Za-z]:", name) or ".." in name.split("/"):
        raise InvalidScanError(f"{where}: the path {relative!r} must lie inside the scan's folder.")
    if any(ord(c) < 32 or ord(c) == 127 for c in name) or len(name) > LIMITS.max_path_characters:
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
    """Return the file `name` of the scan, in whatever case if that is the only one, or None where there is none."""
    path = resolve_inside(directory, name, name)
    if path.is_file():
        return path
    others = [child.name for child in directory.iterdir() if child.name.lower() == name.lower()]
    if len(others) != 1:
        return None
    path = resolve_inside(directory, others[0], name)
    return path if path.is_file() else None


def read_text(path: Path) -> str:
    """Return the text of a list file: UTF-8, UTF-16 with a byte-order mark, else code page 437.

    That page has a character for every byte, so that names in another page can be compared (`ScanFolder`). Raises
    `InvalidScanError` past the limit on bytes.
    """
    if path.stat().st_size > LIMITS.max_list_bytes:
        raise InvalidScanError(
            f"{path.name} is larger than {LIMITS.max_list_bytes // MIB} MB, too large for a list."
        )
    data = path.read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp437")


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


def whole_numbers(cells: list[str], where: str) -> list[int]:
    """Return the cells as whole numbers; raises `InvalidScanError` naming `where`."""
    values = numbers(cells, where)
    if not all(value.is_integer() for value in values):
        raise InvalidScanError(f"{where}: {' '.join(cells)[:80]!r} must be whole numbers.")
    return [int(value) for value in values]


@dataclass(frozen=True, slots=True)
class CameraFile:
    """What `camera.txt` states: the camera, maybe a depth scale."""

    camera: CameraHint
    depth_scale: float | None


def read_camera_file(directory: Path) -> CameraFile | None:
    """Return the contents of `camera.txt`, None where there is none.

    Its one row is `MODEL width height params...` (COLMAP's names and order) or `fx fy cx cy [k1 k2 p1 p2 [k3]]`, or it
    holds the rows of a 3x3 calibration matrix; a comment may state `depth_scale = N`, units per metre. Raises
    `InvalidScanError` for anything else.
    """
    path = optional_file(directory, "camera.txt")
    if path is None:
        return None
    text = read_text(path)
    lines = list(rows(text))
    scale = _DEPTH_SCALE.search(text)
    depth_scale = numbers([scale.group(1)], "camera.txt: depth_scale")[0] if scale else None
    if depth_scale is not None and not 0 < depth_scale < np.inf:
        raise InvalidScanError("camera.txt: depth_scale must be above 0, in units per metre.")
    if len(lines) == 1:
        return CameraFile(_camera_of_cells(lines[0].cells()), depth_scale)
    return CameraFile(_camera_of_matrix([line.cells() for line in lines]), depth_scale)


def _camera_of_matrix(cells: list[list[str]]) -> CameraHint:
    """Return the camera of the rows of a calibration matrix, 3x3 or its 3x4 or 4x4 form."""
    if len(cells) not in (3, 4) or {len(row) for row in cells} not in ({3}, {4}):
        raise InvalidScanError(
            f"camera.txt must hold one row, `MODEL width height params...`, or a 3x3 matrix, not {len(cells)} rows."
        )
    return _stated([numbers(row, "camera.txt")[:3] for row in cells[:3]])


def _stated(value: object) -> CameraHint:
    """Return the camera that a value states as one of a request would."""
    try:
        hint = parse_camera_hint(value, "camera.txt")
    except InvalidInputError as error:
        raise InvalidScanError(f"camera.txt: {str(error).removeprefix('camera.txt ')}") from None
    assert hint is not None  # noqa: S101 - of a value
    return hint


def _camera_of_cells(cells: list[str]) -> CameraHint:
    if not re.match(r"[A-Za-z_]+$", cells[0]):
        return CameraHint(values=tuple(numbers(cells, "camera.txt")))
    known = (*MODEL_PARAMETERS, *SIMPLE_MODELS)
    if cells[0] not in known:
        raise InvalidScanError(f"camera.txt: model {cells[0]!r} is not known; use one of {', '.join(known)}.")
    values = numbers(cells[1:], "camera.txt")
    if len(values) < 3 or any(not v.is_integer() for v in values[:2]):
        raise InvalidScanError(
            "camera.txt: after the model come width and height in whole pixels, then params."
        )
    return _stated({"model": cells[0], "width": values[0], "height": values[1], "params": values[2:]})


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
