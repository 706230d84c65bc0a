"""Changes to written scans: to JSON files, and to each frame of nerfstudio's list."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.tests.formats.scans import CAMERA

Change = Callable[[Path], object]


def edited(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def each_frame(change: Callable[[dict[str, Any]], object]) -> Change:
    """Return what changes each frame of nerfstudio's list."""
    return lambda folder: edited(
        folder / "transforms.json", lambda content: [change(frame) for frame in content["frames"]]
    )


def top(**values: Any) -> Change:
    """Return what changes values of nerfstudio's file; None leaves one out."""

    def change(content: dict[str, Any]) -> None:
        content.update(values)
        for key in [key for key, value in values.items() if value is None]:
            content.pop(key)

    return lambda folder: edited(folder / "transforms.json", change)


def both(*changes: Change) -> Change:
    return lambda folder: [change(folder) for change in changes]


FX, FY, CX, CY = CAMERA.params[:4]
