"""All scan formats: which one a folder holds, and the scan in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Protocol

from app.errors import InvalidScanError
from app.importers import nerfstudio, redwood, scannet, seven_scenes, tum
from app.importers.conventions import PoseArrays, PoseConvention
from app.importers.frames import Scan, ScanOptions
from app.importers.layouts import colmap, kapture, rtabmap_export, twelve_scenes
from app.importers.phones import arkit_scenes, polycam, record3d, scanner_app, stray_scanner
from app.importers.recordings import ros_bag, rtabmap, sens
from app.importers.time_offset import with_time_offset
from app.importers.unposed import pictures
from app.importers.unposed.scan import UnposedScan
from app.importers.unread.incomplete import describe_incomplete
from app.importers.unread.other_formats import describe_other_format
from app.limits import limit


class Importer(Protocol):
    """A scan format: the interface of the modules `tum`, `seven_scenes` and so on."""

    def detect(self, directory: Path, /) -> bool:
        """Return whether the folder looks like a scan of this format."""

    def open_scan(self, directory: Path, options: ScanOptions, /) -> Scan:
        """Return the scan; raises `InvalidScanError`."""


# In the order in which a folder is asked.
FORMATS: dict[str, Importer] = {
    "tum": tum,
    "12scenes": twelve_scenes,
    "7scenes": seven_scenes,
    "nerfstudio": nerfstudio,
    "polycam": polycam,
    "scannet": scannet,
    "redwood": redwood,
    "stray-scanner": stray_scanner,
    "record3d": record3d,
    "3d-scanner-app": scanner_app,
    "arkitscenes": arkit_scenes,
    "sens": sens,
    "rtabmap": rtabmap,
    "rtabmap-export": rtabmap_export,
    "ros-bag": ros_bag,
    "kapture": kapture,
    "colmap": colmap,
}


WITHOUT_POSES = "Camera poses are needed here: only builds and inspections read pictures without them."


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchOptions:
    """Where a scan is looked for below the folder that was sent."""

    max_depth: int = limit(
        4, "Folders below the first that are searched.", chosen="By hand: deeper than any export puts a scan."
    )
    max_folders: int = limit(
        2000,
        "Folders that are searched.",
        chosen="By hand: past any archive of scans; a search takes a second.",
    )
    shown: int = limit(6, "Names that a message lists.", chosen="By hand: a sentence that can be read.")


OPTIONS = SearchOptions()


def open_scan(directory: Path, format: str | None = None, options: ScanOptions | None = None) -> Scan:  # noqa: A002
    """Return the scan in a folder, or in the only folder below it that holds one.

    `format` is one of `FORMATS`; None or `auto` finds it from the files. Raises `InvalidScanError`, with a
    sentence naming the file or the frame, for a folder that holds no scan that can become a map, or several, and for
    a video or photos, which have no poses.
    """
    unposed = unposed_format(directory, format)
    if unposed is not None:
        found = pictures.summary_of(pictures.open_pictures(directory, unposed, options or ScanOptions()))
        raise InvalidScanError(f"{found} {WITHOUT_POSES}")
    folder, name = find_scan(directory, format)
    if options is not None and options.motion is not None and name != "tum":
        raise InvalidScanError(
            f"A uniform motion gives poses to scans in TUM layout without groundtruth.txt; this one is {name}."
        )
    given = options or ScanOptions()
    scan = FORMATS[name].open_scan(folder, given)
    # A TUM scan has more poses than frames, and moves their times itself.
    if name != "tum" and given.convention.time_offset_s:
        scan = with_time_offset(scan, given.convention.time_offset_s)
    return _read_by_convention(scan, given.convention)


def open_unposed(directory: Path, format: str | None, options: ScanOptions) -> UnposedScan | None:  # noqa: A002
    """Return pictures whose poses are to be estimated: a video, photos, or any scan where the options ask for it.

    None for a scan with poses. Raises `InvalidScanError` as `open_scan`.
    """
    name = unposed_format(directory, format)
    if name is not None:
        return pictures.open_pictures(directory, name, options)
    if not options.estimate_poses:
        return None
    listed = open_scan(directory, format, options)
    _, name = find_scan(directory, format)
    return UnposedScan(
        format=name,
        listed=replace(listed, gravity=None, trajectory=None),
        camera=options.camera,
        scratch=options.scratch,
    )


def unposed_format(directory: Path, format: str | None) -> str | None:  # noqa: A002
    """Return one of `pictures.FORMATS` where a folder's pictures are read so, None where they are a scan with poses."""
    name = (format or "auto").lower()
    if name in pictures.FORMATS:
        return name
    if name != "auto" or not directory.is_dir() or any(True for _ in _scans(directory, FORMATS)):
        return None
    return pictures.find_format(directory)


def find_scan(directory: Path, format: str | None = None) -> tuple[Path, str]:  # noqa: A002
    """Return the folder that holds a scan, and its format; raises as `open_scan`."""
    if not directory.is_dir():
        raise InvalidScanError(f"The scan's folder {directory.name!r} does not exist.")
    name = (format or "auto").lower()
    if name != "auto" and name not in FORMATS:
        known = [*FORMATS, *pictures.FORMATS]
        raise InvalidScanError(
            f"The scan format {format!r} is not known; use auto, {', '.join(known[:-1])} or {known[-1]}."
        )
    return _find_scan(directory, FORMATS if name == "auto" else {name: FORMATS[name]})


def format_at(folder: Path, importers: Mapping[str, Importer] = FORMATS) -> str | None:
    """Return the format of the scan that begins in a folder, without searching below it; None for no scan."""
    return next((name for name, importer in importers.items() if importer.detect(folder)), None)


def _read_by_convention(scan: Scan, convention: PoseConvention) -> Scan:
    """Return the scan whose poses are written by a convention with poses `scan_from_camera`; times are done already."""
    if convention.without_times() == PoseConvention():
        return scan
    poses = convention.read(PoseArrays.of([frame.scan_from_camera for frame in scan.frames])).poses()
    frames = tuple(
        replace(frame, scan_from_camera=pose) for frame, pose in zip(scan.frames, poses, strict=True)
    )
    gravity = None if scan.gravity is None else convention.direction_in_own(scan.gravity)
    return replace(scan, frames=frames, gravity=gravity)


def _find_scan(directory: Path, importers: Mapping[str, Importer]) -> tuple[Path, str]:
    """Return the folder that holds a scan, and its format."""
    found = list(_scans(directory, importers))
    if len(found) == 1:
        return found[0]
    if found:
        names = [f"{folder.relative_to(directory).as_posix()} ({name})" for folder, name in found]
        more = f" and {len(names) - OPTIONS.shown} more" if len(names) > OPTIONS.shown else ""
        raise InvalidScanError(
            f"The archive holds {len(found)} scans: {', '.join(names[: OPTIONS.shown])}{more}. Send each in an archive "
            "of its own."
        )
    # A format that was asked for says itself what it misses.
    if len(importers) == 1:
        return directory, next(iter(importers))
    incomplete = describe_incomplete(_files_below(directory))
    described = filter(None, (describe_other_format(folder) for folder in _folders(directory)))
    raise InvalidScanError(incomplete or next(described, None) or _nothing_found(directory))


def _scans(directory: Path, importers: Mapping[str, Importer]) -> Iterator[tuple[Path, str]]:
    """Yield the folders that hold a scan, each with its format, none inside of another."""
    inside: list[Path] = []
    for folder in _folders(directory):
        if any(folder.is_relative_to(scan) for scan in inside):
            continue
        name = format_at(folder, importers)
        if name is not None:
            inside.append(folder)
            yield folder, name


def _folders(directory: Path) -> Iterator[Path]:
    """Yield a folder and those below it, level by level, without following links."""
    level, count = [directory], 0
    for _ in range(OPTIONS.max_depth + 1):
        below: list[Path] = []
        for folder in level:
            count += 1
            if count > OPTIONS.max_folders:
                return
            yield folder
            below += sorted(child for child in folder.iterdir() if child.is_dir() and not child.is_symlink())
        level = below


def _files_below(directory: Path) -> list[str]:
    """Return the paths of the files in the folders that are searched, hidden ones left out, each with the name of the
    first folder: that may be part of a format, as `keyframes` is."""
    files = (
        path for folder in _folders(directory) for path in folder.iterdir() if not path.name.startswith(".")
    )
    return sorted(path.relative_to(directory.parent).as_posix() for path in files if path.is_file())


def _nothing_found(directory: Path) -> str:
    names = sorted(child.name for child in directory.iterdir())
    if names and all(PurePath(name).suffix.lower() in pictures.PHOTO_SUFFIXES for name in names):
        return f"A map of photos needs {pictures.MIN_PHOTOS} or more of one place; there are {len(names)}."
    there = ", ".join(names[: OPTIONS.shown]) + (", ..." if len(names) > OPTIONS.shown else "")
    others = ", ".join(name for name in FORMATS if name not in ("tum", "7scenes"))
    return (
        "The format of the scan can't be told from its files: a TUM scan has rgb.txt, depth.txt and groundtruth.txt; a "
        "7-Scenes scan frame-000000.color.png and so on, at the top or in seq-01; the other formats that are read are "
        f"{others}. At the top are: {there or 'no files'}."
    )
