"""Stray Scanner: `rgb.mp4`, `odometry.csv`, `camera_matrix.csv`, and the folders `depth` and `confidence`.

Source of the layout: the page on its format and OdometryEncoder.swift of github.com/strayrobots/scanner. Newer versions
write each frame's intrinsics behind its pose, the first ones wrote depth as NumPy arrays. The app turns
ARKit's camera axes into x right, y down, z forward; the world is ARKit's, y up.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frame_files.spacing import spaced_rows
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.phones.arkit import ARKIT_DOWN, confidence_files
from app.importers.phones.video import Video, open_video
from app.importers.scan_camera import camera_stated_in
from app.importers.scan_files import numbers, optional_file, read_text, rows
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import lacking
from app.limits import limit

FORMAT = "stray-scanner"
ODOMETRY = "odometry.csv"
MATRIX = "camera_matrix.csv"
VIDEOS = ("rgb.mp4", "rgb.mov")
DEFAULT_DEPTH_SCALE = 1000.0
# The pictures of the video, where somebody has taken them out.
COLOR_FOLDERS = ("rgb", "color", "images")
DEPTH_SUFFIXES = (".png", ".npy")
_COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_INTRINSICS = ("fx", "fy", "cx", "cy")
_PICTURE = re.compile(r"(\d{1,9})\.(?:jpe?g|png)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class StrayScannerOptions:
    """Which intrinsics are believed."""

    max_focal_difference_ratio: float = limit(
        0.05,
        "Focal lengths of the frames that differ from camera_matrix.csv's by more than this are for other pictures.",
        chosen="By hand: autofocus moves them by 1 to 3 %; a video of another size by half or more.",
    )


OPTIONS = StrayScannerOptions()


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of the odometry: time, number of the picture in the video, pose (None if it is none), and `fx fy cx cy`
    where it states them."""

    time_s: float
    number: int
    scan_from_camera: Pose | None
    intrinsics: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class _Colors:
    """The colour pictures: a video, or files by their numbers in it, with their size."""

    size: tuple[int, int]
    video: Video | None = None
    files: Mapping[int, Path] = field(default_factory=dict)


def detect(directory: Path) -> bool:
    """Return whether the folder holds the app's poses, and its camera or its video."""
    names = (MATRIX, *VIDEOS)
    return optional_file(directory, ODOMETRY) is not None and any(
        optional_file(directory, name) is not None for name in names
    )


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a recording; the frames are taken out of its video.

    Depth is in 1000 per metre, without what has low confidence; a phone without LiDAR records none. Raises
    `InvalidScanError` for tables that are not the app's and a video that can't be decoded.
    """
    folder = ScanFolder(directory)
    odometry = optional_file(directory, ODOMETRY)
    if odometry is None:
        raise lacking(FORMAT, ODOMETRY, "its camera poses")
    video = next(filter(None, (optional_file(directory, name) for name in VIDEOS)), None)
    recorded = None if video is None else open_video(video)
    table, files, discarded = _rows(odometry), FrameFiles(options.scratch), Discarded()
    colors = _pictures_of(folder, table) if recorded is None else _Colors(recorded.size, recorded)
    depth = folder.subfolder("depth")
    has_depth = depth is not None and bool(folder.files_in(depth))
    frames, kept = _frames(folder, colors, table, files, has_depth, discarded)
    confidence = confidence_files(folder, "depth", "confidence")
    cameras = [] if options.camera else _cameras(directory, kept, colors.size)
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        notes=_notes(table, colors, len(frames)),
        confidence=confidence,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _pictures_of(folder: ScanFolder, table: list[_Row]) -> _Colors:
    """Return the pictures that were taken out of the video, which is not there."""
    pictures = folder.subfolder(*COLOR_FOLDERS)
    matches = (
        (_PICTURE.fullmatch(file.name), file) for file in (folder.files_in(pictures) if pictures else ())
    )
    found = {int(match.group(1)): file for match, file in matches if match}
    size = next(filter(None, (color_size(file) for file in found.values())), None)
    if size is None:
        raise lacking(FORMAT, VIDEOS[0], "its colour images")
    # Tools that take pictures out of a video count from 1, the app from 0.
    if min(found) == 1 and max(found) == max(row.number for row in table) + 1:
        found = {number - 1: file for number, file in found.items()}
    return _Colors(size, files=found)


def _frames(
    folder: ScanFolder,
    colors: _Colors,
    table: list[_Row],
    files: FrameFiles,
    has_depth: bool,
    discarded: Discarded,
) -> tuple[list[Frame], list[_Row]]:
    """Return the frames that are complete, and the row of each."""
    there = table if colors.video else [row for row in table if row.number in colors.files]
    for number in set(colors.files) - {row.number for row in there}:
        name = folder.name_of(colors.files[number])
        discarded.add("no_pose", name, f"{ODOMETRY} has no row for {name}")
    wanted = {there[i].number: there[i] for i in spaced_rows([row.time_s for row in there])}
    invalid = [row.number for row in wanted.values() if row.scan_from_camera is None]
    check_pose_ratio(len(invalid), len(wanted), f"that of frame {invalid[0]}" if invalid else "")
    frames, kept = [], []
    for number, name, picture in _pictures(folder, colors, set(wanted), files):
        row = wanted.pop(number)
        stem = f"depth/{number:06d}"
        found = (folder.find(f"{stem}{suffix}", "the scan") for suffix in DEPTH_SUFFIXES)
        depth = next(filter(None, found), None) if has_depth else picture
        if row.scan_from_camera is None:
            discarded.add("invalid_pose", name)
        elif depth is None:
            missing = f"{stem}{DEPTH_SUFFIXES[0]}"
            discarded.add("no_depth", name, f"{missing} is missing; {folder.instead(missing)}")
        else:
            frames.append(Frame(name, row.time_s, picture, depth, row.scan_from_camera))
            kept.append(row)
    if colors.video is not None:
        for number in wanted:
            detail = f"{colors.video.path.name} ends before picture {number} of {ODOMETRY}"
            discarded.add("missing_file", f"{colors.video.path.name}/{number:06d}", detail)
    return frames, kept


def _pictures(
    folder: ScanFolder, colors: _Colors, wanted: set[int], files: FrameFiles
) -> Iterator[tuple[int, str, Path]]:
    """Yield number, name and file of the wanted pictures; those of a video are written."""
    if colors.video is None:
        for number in sorted(wanted):
            yield number, folder.name_of(colors.files[number]), colors.files[number]
        return
    last = max(wanted)
    for number, picture in enumerate(colors.video.pictures()):
        if number in wanted:
            file = files.write_picture(f"rgb/{number:06d}.jpg", picture)
            yield number, f"{colors.video.path.name}/{number:06d}", file
        if number >= last:
            return


def _notes(table: list[_Row], colors: _Colors, kept: int) -> tuple[str, ...]:
    notes = []
    name = colors.video.path.name if colors.video else "the recording"
    if kept < len(table):
        notes.append(f"Of {len(table)} pictures of {name}, {kept} were taken, 20 a second at most.")
    if colors.video and colors.video.count and colors.video.count != len(table):
        notes.append(
            f"{name} has {colors.video.count} pictures and {ODOMETRY} {len(table)} rows; they were paired by the "
            "frame's number."
        )
    return tuple(notes)


def _rows(path: Path) -> list[_Row]:
    # The reader of CSV files ends lines by itself, and raises its own error for a carriage return within one.
    reader = csv.reader(io.StringIO(read_text(path), newline=None))
    header = [name.strip().lower() for name in next(reader, [])]
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise InvalidScanError(
            f"{path.name} has no column {missing[0]!r}; its header must name {', '.join(_COLUMNS)}."
        )
    columns = [header.index(name) for name in _COLUMNS]
    of_camera = [header.index(name) for name in _INTRINSICS if name in header]
    table = []
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{path.name} line {reader.line_num}"
        if len(cells) <= max(columns):
            raise InvalidScanError(f"{where}: expected {len(header)} columns and found {len(cells)}.")
        values = numbers([cells[i].strip() for i in columns], where)
        if not np.isfinite(values[:2]).all() or values[1] < 0:
            raise InvalidScanError(f"{where}: timestamp and frame must be numbers, the frame's 0 or more.")
        stated = [cells[i].strip() for i in of_camera if i < len(cells)]
        camera = numbers(stated, where) if len(stated) == len(_INTRINSICS) and all(stated) else []
        is_known = bool(camera) and np.isfinite(camera).all() and min(camera[:2]) > 0
        table.append(_Row(values[0], int(values[1]), _pose(values[2:]), tuple(camera) if is_known else ()))
    if not table:
        raise InvalidScanError(f"The scan has no camera poses: {path.name} lists none.")
    return sorted(table, key=lambda row: row.time_s)


def _pose(values: list[float]) -> Pose | None:
    try:
        return Pose.from_quaternion(values[:3], values[3:])
    except InvalidPoseError:
        return None


def _cameras(directory: Path, kept: list[_Row], size: tuple[int, int]) -> list[Camera | None]:
    """Return the camera of each row: by its own intrinsics where they are near those of the matrix, else by these."""
    path = optional_file(directory, MATRIX)
    stated = None if path is None else _of_matrix(path)
    cameras: list[Camera | None] = []
    for row in kept:
        own = row.intrinsics or stated
        if own is None:
            raise lacking(FORMAT, MATRIX, "its camera's intrinsics")
        is_other = stated and abs(own[0] / stated[0] - 1) > OPTIONS.max_focal_difference_ratio
        with camera_stated_in("camera"):
            cameras.append(Camera("PINHOLE", *size, stated if stated and is_other else own))
    return cameras


def _of_matrix(path: Path) -> tuple[float, ...]:
    values = numbers([cell for row in rows(read_text(path)) for cell in row.cells()], path.name)
    if len(values) != 9 or not values[0] > 0:
        raise InvalidScanError(
            f"{path.name} must hold a matrix of 3x3 numbers, the focal lengths first, not {len(values)} of them."
        )
    return values[0], values[4], values[2], values[5]
