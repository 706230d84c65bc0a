"""Directories that are complete or not there: made beside their place, resumed if interrupted, then
renamed."""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from app.errors import InvalidInputError

MARKER = "demonstration.json"


def is_complete(directory: Path, recipe: dict[str, Any]) -> bool:
    """Return whether a directory holds what the recipe describes."""
    return _recipe_in(directory) == recipe


def make_directory(directory: Path, recipe: dict[str, Any], fill: Callable[[Path], None]) -> None:
    """Have `fill` write into a directory that appears only once complete; do nothing when it is there.

    A part left by a killed process is handed to `fill` again if it was for the same recipe. An older render
    is replaced. Raises `InvalidInputError` when the directory holds something else.
    """
    directory.parent.mkdir(parents=True, exist_ok=True)
    with _locked(directory.with_name(directory.name + ".lock")):
        if is_complete(directory, recipe):
            return
        if directory.exists() and _recipe_in(directory) is None and any(directory.iterdir()):
            raise InvalidInputError(
                f"{directory} is not empty and holds no demonstration render; choose another."
            )
        partial = directory.with_name(directory.name + ".partial")
        plan = partial / "recipe.json"
        if not plan.is_file() or json.loads(plan.read_text()) != recipe:
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            plan.write_text(json.dumps(recipe))
        fill(partial)
        plan.replace(partial / MARKER)
        shutil.rmtree(directory, ignore_errors=True)
        partial.rename(directory)


def _recipe_in(directory: Path) -> dict[str, Any] | None:
    try:
        return dict(json.loads((directory / MARKER).read_text()))
    except (OSError, ValueError):
        return None


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Let one process at a time in."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is never seen half-written."""
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)
