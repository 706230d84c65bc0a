"""The rows of a trajectory file: which columns hold time, position and attitude, and in which unit and order."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.importers.rows.matrices import COUNTS, poses_of_matrices
from app.importers.rows.times import in_seconds
from app.importers.scan_files import Row, numbers, rows
from app.limits import limit

Array = NDArray[np.float64]

COLUMNS = "timestamp tx ty tz qx qy qz qw"
# What a pose row has: the TUM format, and RTAB-Map's format 11 with an id behind it.
POSE_COLUMNS = 8
POSE_AND_ID_COLUMNS = 9
MATRIX_COLUMNS = tuple(count + 1 for count in COUNTS)

_UNIT = re.compile(r"[\[(].*?[\])]")
_POSITION = re.compile(r"(?:t|p|pos|position|translation)?(?:_\w+?)?_?([xyz])$")
_QUATERNION = re.compile(r"(?:q|quat|quaternion|rot|rotation|orientation)(?:_\w+?)?_?([wxyz])$")
_TIME = re.compile(r"#?\s*(?:t|time|stamp|timestamp|time_?stamp\w*|seconds?)$")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryOptions:
    """When numbers can't be poses."""

    max_norm_error: float = limit(
        0.1,
        "Quaternions whose norm differs from 1 by more than this, by the median, are no quaternions.",
        chosen="By hand: printed with two digits they differ by 0.01; angles and matrices by far more.",
    )


OPTIONS = TrajectoryOptions()


@dataclass(frozen=True, slots=True)
class TrajectoryRows:
    """Rows (n, 8) `t x y z qx qy qz qw`, with NaN where a row holds no pose, and sentences on how they were read.

    `t` is in seconds; it is NaN for all rows of a file that holds no times.
    """

    values: Array
    notes: tuple[str, ...] = ()

    @property
    def times_s(self) -> Array:
        """The times (n,) in seconds."""
        return np.asarray(self.values[:, 0])


def parse_trajectory(text: str, name: str) -> TrajectoryRows:
    """Return the rows of a trajectory file called `name`.

    Rows of 8 columns are time, position and quaternion, in the order that a header names, else `COLUMNS`; a ninth
    column may hold an id; 13 or 17 columns are time and a 3x4 or 4x4 matrix; 12 or 16 such a matrix alone. Raises
    `InvalidScanError` that names file, line and cause.
    """
    lines = list(rows(text))
    header, lines = _header(text, lines)
    if not lines:
        raise InvalidScanError(f"The scan has no camera poses: {name} lists none.")
    cells = [row.cells() for row in lines]
    count = _check_columns(lines, cells, name)
    table = np.array([numbers(c, f"{name} line {row.line}") for row, c in zip(lines, cells, strict=True)])
    order = _named_order(header, count)
    if order is None and count == POSE_AND_ID_COLUMNS and not _are_ids(table[:, 8]):
        raise InvalidScanError(
            f"{name} line {lines[0].line}: expected 8 columns, {COLUMNS}, and found {count}."
        )
    timed = order is not None or count not in COUNTS
    if timed:
        _check_times(table[:, 0 if order is None else order[0]], lines, cells, name)
    if order is not None:
        return _with_times(table[:, order], name, _order_note(order, name))
    if count in (POSE_COLUMNS, POSE_AND_ID_COLUMNS):
        _check_quaternions(table[:, 4:8], lines, name)
        return _with_times(table[:, :8], name, ())
    values, notes = _from_matrices(table[:, 1:] if timed else table, name)
    if not timed:
        return TrajectoryRows(values, notes)
    values[:, 0] = table[:, 0]
    return _with_times(values, name, notes)


def _check_columns(lines: list[Row], cells: list[list[str]], name: str) -> int:
    """Return how many columns all rows have; raises for rows that differ and for counts that no pose has."""
    counts = Counter(len(c) for c in cells)
    usual = counts.most_common(1)[0][0]
    known = (POSE_COLUMNS, POSE_AND_ID_COLUMNS, *COUNTS, *MATRIX_COLUMNS)
    first = next((i for i, c in enumerate(cells) if len(c) != usual), 0)
    # Numbers with decimal commas between commas come apart into twice as many, without any point.
    doubled = usual == 2 * POSE_COLUMNS and "," in lines[0].text and not any("." in row.text for row in lines)
    if len(counts) == 1 and usual in known and not doubled:
        return usual
    line, found = lines[first], len(cells[first])
    where = f"{name} line {line.line}"
    if re.search(r"\d,\d", line.text) and (doubled or usual not in known):
        raise InvalidScanError(
            f"{where}: expected 8 columns, {COLUMNS}, and found {found}: decimal commas? Write numbers with points."
        )
    others = f", where the other rows have {usual}" if len(counts) > 1 else ""
    raise InvalidScanError(f"{where}: expected 8 columns, {COLUMNS}, and found {found}{others}.")


def _check_times(times: Array, lines: list[Row], cells: list[list[str]], name: str) -> None:
    wrong = np.flatnonzero(~np.isfinite(times))
    if len(wrong):
        where, cell = f"{name} line {lines[wrong[0]].line}", cells[wrong[0]][0]
        raise InvalidScanError(f"{where}: the timestamp {cell[:40]!r} must be a number of seconds.")


def _check_quaternions(quaternions: Array, lines: list[Row], name: str) -> None:
    """Raise if most of the quaternions (n, 4) that are not zero or NaN are far from length 1."""
    norms = np.linalg.norm(quaternions, axis=1)
    usable = np.isfinite(norms) & (norms > 0)
    if usable.any() and np.median(np.abs(norms[usable] - 1)) > OPTIONS.max_norm_error:
        first = int(np.flatnonzero(usable)[0])
        raise InvalidScanError(
            f"{name} line {lines[first].line}: the last four columns must be a unit quaternion qx qy qz qw; their "
            f"length is {norms[first]:.3g}."
        )


def _are_ids(column: Array) -> bool:
    return bool(np.isfinite(column).all() and (column == np.round(column)).all())


def _with_times(values: Array, name: str, notes: tuple[str, ...]) -> TrajectoryRows:
    times = in_seconds(values[:, 0])
    values = np.column_stack([times.times_s, values[:, 1:]])
    if times.unit != "seconds":
        notes = (*notes, f"The times of {name} were read as {times.unit}.")
    return TrajectoryRows(values, notes)


def _from_matrices(table: Array, name: str) -> tuple[Array, tuple[str, ...]]:
    poses, by_columns = poses_of_matrices(list(table))
    values = np.full((len(poses), 8), np.nan)
    for i, pose in enumerate(poses):
        if pose is not None:
            values[i, 1:] = [*pose.translation, *pose.quaternion]
    shape = "3x4" if table.shape[1] == COUNTS[0] else "4x4"
    return values, (
        f"The poses of {name} were read as {shape} matrices by {'columns' if by_columns else 'rows'}.",
    )


def _header(text: str, lines: list[Row]) -> tuple[list[str], list[Row]]:
    """Return the names of the columns, if a comment or a first row has them, and the rows without that one."""
    comments = [
        line.strip(" \t#\ufeff") for line in text.splitlines() if line.strip(" \t\ufeff").startswith("#")
    ]
    if lines and not any(_is_number(cell) for cell in lines[0].cells()):
        return _names(lines[0].text), lines[1:]
    return (_names(comments[-1]) if comments else []), lines


def _names(text: str) -> list[str]:
    return [
        _UNIT.sub("", name).strip().lower()
        for name in re.split(r"[,;]" if re.search("[,;]", text) else r"\s+", text)
    ]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _named_order(names: list[str], count: int) -> list[int] | None:
    """Return the columns of `t x y z qx qy qz qw` by a header, None for one that doesn't name each of them once."""
    if len(names) != count:
        return None
    found: dict[str, list[int]] = {key: [] for key in ("t", "x", "y", "z", "qx", "qy", "qz", "qw")}
    for column, name in enumerate(names):
        if match := _QUATERNION.match(name):
            found[f"q{match.group(1)}"].append(column)
        elif match := _POSITION.match(name):
            found[match.group(1)].append(column)
        elif _TIME.match(name):
            found["t"].append(column)
    if any(len(columns) != 1 for columns in found.values()):
        return None
    return [columns[0] for columns in found.values()]


def _order_note(order: list[int], name: str) -> tuple[str, ...]:
    if order == list(range(POSE_COLUMNS)):
        return ()
    return (f"The columns of {name} were read in the order that its header names.",)
