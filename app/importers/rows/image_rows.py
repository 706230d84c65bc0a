"""Lists of images by time: `rgb.txt` and `depth.txt`, or both in one association file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.importers.rows.times import in_seconds
from app.importers.scan_files import Row, numbers, rows

# One number, which may have a decimal comma, what separates it, and the rest of the line.
_ROW = re.compile(r"([-+]?\d+,\d+(?=[;\s]+[^\d\s])|[^,;\s]+)[,;\s]+(\S.*)$")
_PAIR = re.compile(r"(\S.*?)[,;\s]+([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)[,;\s]+(\S.*)$")
_PATH = re.compile(r"[./\\]")
_SUFFIX = re.compile(r"\.\w{2,5}[\"']?$")


@dataclass(frozen=True, slots=True)
class ImageRows:
    """Times (n,) in seconds and, for each, the image's name and the place that names it (`rgb.txt line 3`)."""

    times_s: NDArray[np.float64]
    names: tuple[str, ...]
    places: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(slots=True)
class _Columns:
    times: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)

    def add(self, time: str, name: str, where: str) -> None:
        self.times.append(_timestamp(_unquoted(time), where))
        self.names.append(_unquoted(name))
        self.places.append(where)

    def rows(self, file: str) -> ImageRows:
        times = in_seconds(np.array(self.times))
        notes = () if times.unit == "seconds" else (f"The times of {file} were read as {times.unit}.",)
        return ImageRows(times.times_s, tuple(self.names), tuple(self.places), notes)


def parse_image_list(text: str, name: str, content: str) -> ImageRows:
    """Return the rows `timestamp file` of a list called `name`; `content` is `colour` or `depth`, for messages.

    Raises `InvalidScanError` that names the line.
    """
    columns = _Columns()
    for row in rows(text):
        where = f"{name} line {row.line}"
        match = _ROW.match(row.text)
        if match is None:
            raise InvalidScanError(f"{where}: expected a timestamp and a file name.")
        if _is_header(row, match.group(1), columns):
            continue
        columns.add(match.group(1), match.group(2), where)
    if not columns.times:
        raise InvalidScanError(f"{name} lists no {content} images.")
    return columns.rows(name)


def parse_associations(text: str, name: str) -> tuple[ImageRows, ImageRows] | None:
    """Return colour and depth of rows `timestamp file timestamp file`, None for a file with any other row.

    The list whose names speak of depth is the depth; where neither or both do, colour comes first.
    """
    first, second = _Columns(), _Columns()
    for row in rows(text):
        where = f"{name} line {row.line}"
        match = _ROW.match(row.text)
        pair = _PAIR.match(match.group(2)) if match else None
        if (
            match is None
            or pair is None
            or not (_SUFFIX.search(pair.group(1)) and _SUFFIX.search(pair.group(3)))
        ):
            return None
        first.add(match.group(1), pair.group(1), where)
        second.add(pair.group(2), pair.group(3), where)
    if not first.times:
        return None
    if _speaks_of_depth(first.names) and not _speaks_of_depth(second.names):
        first, second = second, first
    return first.rows(name), second.rows(name)


def _speaks_of_depth(names: list[str]) -> bool:
    return all("depth" in name.lower() for name in names)


def _is_header(row: Row, time: str, columns: _Columns) -> bool:
    """Whether a first row names its columns: no number in it, and no path."""
    return not columns.times and re.match(r"[A-Za-z]", time) is not None and not _PATH.search(row.text)


def _timestamp(cell: str, where: str) -> float:
    (time,) = numbers([cell.replace(",", ".")], where)
    if not np.isfinite(time):
        raise InvalidScanError(f"{where}: the timestamp {cell[:40]!r} must be a number of seconds.")
    return time


def _unquoted(name: str) -> str:
    name = name.strip(" \t,;")
    if len(name) > 1 and name[0] == name[-1] and name[0] in "\"'":
        return name[1:-1]
    return name
