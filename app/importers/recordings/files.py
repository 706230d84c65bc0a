"""The one recording in a scan's folder."""

from __future__ import annotations

from pathlib import Path

from app.errors import InvalidScanError


def recordings_in(directory: Path, *suffixes: str) -> list[Path]:
    """Return the files of a folder with one of these suffixes, in the order of their names, without links and hidden
    files."""
    return sorted(
        path
        for path in directory.iterdir()
        if path.name.lower().endswith(suffixes)
        and path.is_file()
        and not path.is_symlink()
        and path.name[0] != "."
    )


def the_recording(directory: Path, *suffixes: str) -> Path:
    """Return the only recording of a folder; raises `InvalidScanError` for none and for several."""
    found = recordings_in(directory, *suffixes)
    if len(found) != 1:
        names = ", ".join(path.name for path in found[:3])
        raise InvalidScanError(
            f"The scan has {len(found)} recordings, {names}: send only one."
            if found
            else f"The scan has no {' or '.join(suffixes)} file."
        )
    return found[0]
