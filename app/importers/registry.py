"""All scan formats: which one a folder holds, and the scan in it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from app.errors import InvalidScanError
from app.importers import seven_scenes, tum
from app.importers.frames import Scan, ScanOptions


class Importer(Protocol):
    """A scan format: the interface of the modules `tum` and `seven_scenes`."""

    def detect(self, directory: Path, /) -> bool:
        """Return whether the folder looks like a scan of this format."""

    def open_scan(self, directory: Path, options: ScanOptions, /) -> Scan:
        """Return the scan; raises `InvalidScanError`."""


FORMATS: dict[str, Importer] = {"tum": tum, "7scenes": seven_scenes}


def open_scan(directory: Path, format: str | None = None, options: ScanOptions | None = None) -> Scan:  # noqa: A002
    """Return the scan in a folder.

    `format` is `tum` or `7scenes`; None or `auto` tells it from the files. Raises `InvalidScanError`, with a
    sentence naming the file or the frame, for a folder that holds no scan that can become a map.
    """
    if not directory.is_dir():
        raise InvalidScanError(f"The scan's folder {directory.name!r} does not exist.")
    name = (format or "auto").lower()
    if name == "auto":
        name = next((n for n, importer in FORMATS.items() if importer.detect(directory)), "")
        if not name:
            raise InvalidScanError(
                "The format of the scan can't be told from its files: a TUM scan has rgb.txt, depth.txt and "
                "groundtruth.txt; a 7-Scenes scan frame-000000.color.png and so on, at the top or in seq-01."
            )
    if name not in FORMATS:
        raise InvalidScanError(f"The scan format {format!r} is not known; use auto, {' or '.join(FORMATS)}.")
    if options is not None and options.motion is not None and name != "tum":
        raise InvalidScanError(
            f"A uniform motion gives poses to scans in TUM layout without groundtruth.txt; this one is {name}."
        )
    return FORMATS[name].open_scan(directory, options or ScanOptions())
