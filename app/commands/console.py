"""What the commands share: the console, settings from options, progress bars."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from app.errors import InvalidInputError
from app.settings import Settings, read_settings

console = Console()
# What a command reports goes to standard output; what happens meanwhile to standard error.
errors = Console(stderr=True)
DataDir = Annotated[Path | None, typer.Option(help="Folder for database and blobs [ROOMFIX_DATA_DIR].")]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]


def settings_from(**given: Any) -> Settings:
    """Return the settings, with the options that were given in place of the environment's.

    Raises `InvalidInputError` that names each setting that can't be used.
    """
    return read_settings({name: value for name, value in given.items() if value is not None})


class BarProgress:
    """Shows each stage as a bar."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def report(self, stage: str, done: int, total: int) -> None:
        """Move a stage's bar."""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=max(total, 1))
        self._bars.update(self._tasks[stage], completed=done, total=max(total, 1))


@contextmanager
def progress_bars() -> Iterator[BarProgress]:
    """Give a progress that draws bars on a terminal, and nothing elsewhere."""
    columns = (
        SpinnerColumn(), TextColumn("{task.description:10}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    )  # fmt: skip
    with Progress(*columns, console=errors, disable=not errors.is_terminal) as bars:
        yield BarProgress(bars)


def json_object(text: str) -> dict[str, Any]:
    """Return the JSON object of an option; raises `InvalidInputError`."""
    try:
        value = json.loads(text)
    except ValueError as error:
        raise InvalidInputError(f"--options is not JSON: {error}.") from None
    if not isinstance(value, dict):
        raise InvalidInputError("--options must be a JSON object.")
    return value


def direction(text: str) -> NDArray[np.float64]:
    """Return the direction (3,) of an option `x,y,z`; raises `InvalidInputError`."""
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.linalg.norm(values) > 1e-6:
        raise InvalidInputError("--gravity must be three numbers, x,y,z.")
    return values
