"""A tiny scan in a folder, as the evaluation commands take it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scenes import CAMERA, View, scan_files


@pytest.fixture(scope="session")
def scan(tmp_path_factory: pytest.TempPathFactory, views: list[View], queries: list[View]) -> Path:
    """A TUM scan whose last four frames are queries: the map is `0:14`, the queries `14:`."""
    directory = tmp_path_factory.mktemp("scans") / "museum"
    for name, data in scan_files([*views, *queries]).items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    numbers = " ".join(f"{value:g}" for value in CAMERA.params)
    (directory / "camera.txt").write_text(f"PINHOLE {CAMERA.width} {CAMERA.height} {numbers}\n")
    return directory
