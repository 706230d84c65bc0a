"""Stray Scanner: `rgb.mp4`, `odometry.csv`, `camera_matrix.csv`, and the folders `depth` and `confidence`.

Source of the layout: the page on its format and OdometryEncoder.swift of github.com/strayrobots/scanner.
The app turns ARKit's camera axes into x right, y down, z forward; the world is ARKit's, y up.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.spacing import spaced_rows
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.phones.arkit import ARKIT_DOWN, confidence_files
from app.importers.phones.video import Video, open_video
from app.importers.scan_files import numbers, optional_file, read_text, rows
from app.importers.unpacked import WITHOUT_DEPTH, FrameFiles

ODOMETRY = "odometry.csv"
MATRIX = "camera_matrix.csv"
VIDEOS = ("rgb.mp4", "rgb.mov")
DEFAULT_DEPTH_SCALE = 1000.0
_COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of the odometry: time, number of the picture in the video, pose (None if it is none)."""

    time_s: float
    number: int
    scan_from_camera: Pose | None


def detect(directory: Path) -> bool:
    """Return whether the folder holds the app's two tables."""
    return all(optional_file(directory, name) is not None for name in (ODOMETRY, MATRIX))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a recording; the frames are taken out of its video.

    Depth is in 1000 per metre, without what has low confidence; a phone without LiDAR records none. Raises
    `InvalidScanError` for tables that are not the app's and a video that can't be decoded.
    """
    folder = ScanFolder(directory)
    odometry = optional_file(directory, ODOMETRY)
    if odometry is None:
        raise InvalidScanError(f"The scan has no camera poses: {ODOMETRY} is missing.")
    path = next(filter(None, (optional_file(directory, name) for name in VIDEOS)), None)
    if path is None:
        raise InvalidScanError(f"The scan has no colour images: {VIDEOS[0]} is missing.")
    video, table, files, discarded = (
        open_video(path),
        _rows(odometry),
        FrameFiles(options.scratch),
        Discarded(),
    )
    has_depth = folder.subfolder("depth") is not None
    frames = _frames(folder, video, table, files, has_depth, discarded)
    source = ScanSource(
        camera=options.camera or _intrinsics(directory),
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        notes=_notes(table, video, len(frames), has_depth),
        confidence=confidence_files(folder, "depth", "confidence"),
        has_depth=has_depth,
        keeps=files,
    )
    return assemble_scan(frames, discarded, source, options)


def _frames(
    folder: ScanFolder,
    video: Video,
    table: list[_Row],
    files: FrameFiles,
    has_depth: bool,
    discarded: Discarded,
) -> list[Frame]:
    wanted = {table[i].number: table[i] for i in spaced_rows([row.time_s for row in table])}
    invalid = [row.number for row in wanted.values() if row.scan_from_camera is None]
    check_pose_ratio(len(invalid), len(wanted), f"that of frame {invalid[0]}" if invalid else "")
    frames = []
    for number, picture in enumerate(video.pictures()):
        row = wanted.pop(number, None)
        if row is None:
            continue
        name = f"{video.path.name}/{number:06d}"
        depth = folder.find(f"depth/{number:06d}.png", "the scan") if has_depth else None
        if row.scan_from_camera is None:
            discarded.add("invalid_pose", name)
        elif has_depth and depth is None:
            missing = f"depth/{number:06d}.png"
            discarded.add("no_depth", name, f"{missing} is missing; {folder.instead(missing)}")
        else:
            color = files.write_picture(f"rgb/{number:06d}.jpg", picture)
            blank = depth or files.blank_depth(video.width, video.height)
            frames.append(Frame(name, row.time_s, color, blank, row.scan_from_camera))
        if not wanted:
            break
    for number in wanted:
        detail = f"{video.path.name} ends before picture {number} of {ODOMETRY}"
        discarded.add("missing_file", f"{video.path.name}/{number:06d}", detail)
    return frames


def _notes(table: list[_Row], video: Video, kept: int, has_depth: bool) -> tuple[str, ...]:
    notes = [] if has_depth else [WITHOUT_DEPTH]
    if kept < len(table):
        notes.append(
            f"Of {len(table)} pictures of {video.path.name}, {kept} were taken, 20 a second at most."
        )
    if video.count and video.count != len(table):
        notes.append(
            f"{video.path.name} has {video.count} pictures and {ODOMETRY} {len(table)} rows; they were paired by the "
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
        table.append(_Row(values[0], int(values[1]), _pose(values[2:])))
    if not table:
        raise InvalidScanError(f"The scan has no camera poses: {path.name} lists none.")
    return sorted(table, key=lambda row: row.time_s)


def _pose(values: list[float]) -> Pose | None:
    try:
        return Pose.from_quaternion(values[:3], values[3:])
    except InvalidPoseError:
        return None


def _intrinsics(directory: Path) -> CameraHint:
    path = optional_file(directory, MATRIX)
    if path is None:
        raise InvalidScanError(f"The scan's camera is not known: {MATRIX} is missing.")
    values = numbers([cell for row in rows(read_text(path)) for cell in row.cells()], path.name)
    if len(values) != 9:
        raise InvalidScanError(f"{path.name} must hold a matrix of 3x3 numbers, not {len(values)} of them.")
    return CameraHint(values=(values[0], values[4], values[2], values[5]))
