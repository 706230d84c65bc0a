"""A dataset split into database and queries by order in the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from app.errors import InvalidInputError
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.registry import find_scan, open_scan
from app.importers.seven_scenes import sequences_of_split

# Parts that 7-Scenes itself names.
SPLITS = ("train", "test")


def parse_range(text: str) -> slice:
    """Return the slice of `start:stop:step`, each part optional; raises `InvalidInputError`."""
    parts = text.split(":")
    try:
        numbers = [int(part) if part else None for part in parts]
    except ValueError:
        raise InvalidInputError(f"{text!r} is not start:stop:step.") from None
    if not 2 <= len(numbers) <= 3 or (len(numbers) == 3 and numbers[2] is not None and numbers[2] < 1):
        raise InvalidInputError(f"{text!r} is not start:stop:step with a step of 1 or more.")
    return slice(*numbers)


@dataclass(frozen=True, slots=True)
class Split:
    """The scan reduced to its database frames, the query frames, and all frames that are not in the database, which the
    queries are among."""

    database: Scan
    queries: tuple[Frame, ...]
    unmapped: tuple[Frame, ...] = ()


def split_scan(directory: Path, database: str, queries: str, format: str, options: ScanOptions) -> Split:  # noqa: A002
    """Open a scan and split its frames by their order, or as 7-Scenes does (`train`, `test`).

    Raises `InvalidInputError` for an empty part.
    """
    scan = open_scan(directory, format, options)
    chosen = _rows(scan, directory, format, database)
    asked = _without(_rows(scan, directory, format, queries), chosen)
    if not chosen or not asked:
        raise InvalidInputError(
            f"{directory.name} has {len(scan.frames)} frames: {len(chosen)} are left for the database and "
            f"{len(asked)} for queries; both need some."
        )
    part = replace(scan, frames=tuple(scan.frames[i] for i in chosen))
    others = _without(range(len(scan.frames)), chosen)
    return Split(part, tuple(scan.frames[i] for i in asked), tuple(scan.frames[i] for i in others))


def _rows(scan: Scan, directory: Path, format: str, part: str) -> list[int]:  # noqa: A002
    if part not in SPLITS:
        return list(range(len(scan.frames))[parse_range(part)])
    folder, _ = find_scan(directory, format)
    sequences = sequences_of_split(folder, part)
    return [row for row, frame in enumerate(scan.frames) if frame.name.split("/")[0] in sequences]


def _without(rows: Sequence[int], left_out: Sequence[int]) -> list[int]:
    known = set(left_out)
    return [row for row in rows if row not in known]
