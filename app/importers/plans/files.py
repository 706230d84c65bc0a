"""The files of an indoor map: a folder, a zip or one file, read whole within bounds."""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from app.errors import InvalidInputError
from app.limits import limit

SUFFIXES = frozenset({".json", ".geojson", ".osm", ".xml"})
ZIP_MAGIC = b"PK\x03\x04"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFileOptions:
    """How much an indoor map may hold."""

    max_file_bytes: int = limit(
        200_000_000,
        "Bytes of one file of an indoor map, unpacked.",
        chosen="By hand: 1,000 times a file of an office building, and still read in seconds.",
    )
    max_total_bytes: int = limit(
        400_000_000,
        "Bytes of all files of an indoor map together, unpacked.",
        chosen="By hand: twice the largest file.",
    )
    max_files: int = limit(
        2_000, "Files of an indoor map.", chosen="By hand: two files a level for a tower, many times over."
    )


OPTIONS = PlanFileOptions()


@dataclass(frozen=True, slots=True)
class PlanFiles:
    """The files by name, without folders; `name` is what the folder, zip or file is called."""

    name: str
    contents: Mapping[str, bytes]

    def json(self, name: str) -> Mapping[str, Any]:
        """Return the JSON object of a file; raises `InvalidInputError`."""
        if name not in self.contents:
            raise InvalidInputError(f"{self.name} has no {name}, which a map in this format needs.")
        return json_object(name, self.contents[name])


def json_object(name: str, data: bytes) -> Mapping[str, Any]:
    """Return the JSON object in a file's bytes; raises `InvalidInputError` that names the file."""
    try:
        text = data.decode("utf-8-sig")
        value = json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{name} is not JSON: {error}.") from None
    if not isinstance(value, Mapping):
        raise InvalidInputError(f"{name} must hold a JSON object.")
    return value


def _finite(digits: str) -> float:
    """Return a number of JSON; raises `ValueError` for one that is none, as outlines would take it for a place."""
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:20]} is no number that can be used")
    return value


def _whole(digits: str) -> int:
    _finite(digits)
    return int(digits)


def open_plan_files(path: Path) -> PlanFiles:
    """Read a folder with the folders below it, a zip, or one file; raises `InvalidInputError`."""
    if path.is_dir():
        return PlanFiles(path.name, _gathered(_in_folder(path)))
    if not path.is_file():
        raise InvalidInputError(f"There is no file or folder {path}.")
    with path.open("rb") as file:
        is_zip = file.read(4) == ZIP_MAGIC
    if is_zip:
        return PlanFiles(path.stem, _gathered(_in_zip(path)))
    return PlanFiles(path.stem, _gathered(iter([(path.name, _read(path))])))


def _gathered(files: Iterator[tuple[str, bytes]]) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    total = 0
    for name, data in files:
        if name in found:
            raise InvalidInputError(f"There are two files {name}; give a folder or zip of one indoor map.")
        total += len(data)
        if len(found) >= OPTIONS.max_files or total > OPTIONS.max_total_bytes:
            raise InvalidInputError(
                f"An indoor map has {OPTIONS.max_files:,} files and {OPTIONS.max_total_bytes:,} bytes at most."
            )
        found[name] = data
    return found


def _is_wanted(path: PurePosixPath) -> bool:
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in path.parts)
    return path.suffix.lower() in SUFFIXES and not hidden


def _in_folder(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and _is_wanted(PurePosixPath(path.relative_to(folder).as_posix())):
            yield path.name, _read(path)


def _read(path: Path) -> bytes:
    if path.stat().st_size > OPTIONS.max_file_bytes:
        raise InvalidInputError(_too_large(path.name))
    return path.read_bytes()


def _in_zip(path: Path) -> Iterator[tuple[str, bytes]]:
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if len(entries) > OPTIONS.max_files:
                raise InvalidInputError(f"An indoor map has {OPTIONS.max_files:,} files at most.")
            for entry in entries:
                inside = PurePosixPath(entry.filename)
                if entry.is_dir() or not _is_wanted(inside):
                    continue
                with archive.open(entry) as file:
                    # What the entry declares is not believed.
                    data = file.read(OPTIONS.max_file_bytes + 1)
                if len(data) > OPTIONS.max_file_bytes:
                    raise InvalidInputError(_too_large(inside.name))
                yield inside.name, data
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError, RuntimeError) as error:
        raise InvalidInputError(f"{path.name} is no zip that can be read: {error}.") from None


def _too_large(name: str) -> str:
    return f"{name} has more than {OPTIONS.max_file_bytes:,} bytes, the most for a file of an indoor map."
