"""Whether a scan of which no frame has a depth image holds depth anywhere, under names that no frame fits."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from app.importers.folder import ScanFolder

_WORD = "depth"
# What lists and describes images, and is none.
_LISTS = frozenset({".txt", ".csv", ".json", ".yaml", ".yml", ".log", ".traj", ".md", ".ini"})
_PICTURES = frozenset(
    {".png", ".jpg", ".jpeg", ".webp", ".heic", ".avif", ".tif", ".tiff", ".pgm", ".exr", ".npy", ".bin"}
)


def holds_depth(folder: ScanFolder, colors: Iterable[Path | None] = ()) -> bool:
    """Return whether a scan has a file of depth: one with the word in its path, lists and hidden files left out.

    Where a list of depth images names their files freely, `colors` are the scan's colour pictures: a picture in a
    folder that holds none of these counts as well.
    """
    of_colors = {path.parent for path in colors if path is not None}
    return any(_may_be_depth(folder, path, of_colors) for path in folder.path.rglob("*"))


def _may_be_depth(folder: ScanFolder, path: Path, of_colors: set[Path]) -> bool:
    suffix = path.suffix.lower()
    if path.name.startswith(".") or suffix in _LISTS or not path.is_file():
        return False
    is_elsewhere = bool(of_colors) and suffix in _PICTURES and path.parent not in of_colors
    return is_elsewhere or _WORD in folder.name_of(path).lower()
