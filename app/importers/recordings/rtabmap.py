"""RTAB-Map's database (`.db`, SQLite): pictures, depth, cameras and poses of the nodes of its map.

Source of the layout: DBDriverSqlite3.cpp and CameraModel.cpp of github.com/introlab/rtabmap. A node's pose is that of
the robot's or phone's base; the camera's place on it is the local transform of its calibration. The poses that the
database was closed with, after loop closure, are in the table Admin.
"""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.images.depth_files import LIMITS
from app.importers.images.rvl import decode_rvl
from app.importers.recordings.files import recordings_in, the_recording
from app.importers.scan_camera import camera_stated_in
from app.importers.unpacked import FrameFiles

SUFFIX = ".db"
DEFAULT_DEPTH_SCALE = 1000.0
EXPORT = "export it with rtabmap-export --images --poses_camera, and send that folder"
NOT_OPTIMIZED = "The database holds no optimized poses; those of the odometry were read, with their drift."
NOT_JOINED = (
    "Of its {count} maps, which nothing joins, the largest was read: open the database in RTAB-Map and save it to have "
    "them joined."
)
# Header of a serialized camera: version (3), type, width, height, numbers in K, D, R, P and the local transform.
_HEADER = struct.Struct("<11i")
_MONO = 0
# Bytes of a camera before version 0.18: floats fx fy cx cy, width and height from version 0.11.2 on, and its place.
_OLD_SIZES = (4 * (4 + 12), 4 * (6 + 12))
# Depth of newer versions: this, width, height, and the compressed values.
_RVL = b"DEPTHRVL"
_RVL_HEADER = struct.Struct("<8s2I")
_MAX_UNPACKED_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class _Camera:
    """A node's calibration: `fx fy cx cy` with the distortion, and the camera's place on the base."""

    values: tuple[float, ...]
    base_from_camera: Pose


@dataclass(frozen=True, slots=True)
class _Node:
    number: int
    time_s: float
    color: bytes
    depth: bytes
    calibration: bytes


def detect(directory: Path) -> bool:
    """Return whether the folder holds a database with RTAB-Map's tables."""
    return any(_is_database(path) for path in recordings_in(directory, SUFFIX))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a database, a frame for each node that has colour, depth and a pose; without depth if no node
    has any.

    Raises `InvalidScanError` for another kind of file, several cameras on one base, and data that can't be read.
    """
    path = the_recording(directory, SUFFIX)
    if not _is_database(path):
        raise InvalidScanError(f"{path.name} is not a database of RTAB-Map.")
    files, discarded = FrameFiles(options.scratch), Discarded()
    cameras: list[_Camera] = []
    try:
        with closing(_connected(path)) as connection:
            poses, notes = _poses(connection)
            has_depth = _has_depth(connection)
            frames = _frames(connection, path.name, poses, files, discarded, cameras, has_depth=has_depth)
    except sqlite3.DatabaseError as error:
        raise InvalidScanError(
            f"{path.name} can't be read as a database of RTAB-Map, or its version is older than those that are read "
            f"({error}): open it in a newer RTAB-Map and save it, or {EXPORT}."
        ) from None
    if options.camera is None and not cameras:
        raise InvalidScanError(f"{path.name} holds no calibrated pictures.")
    own = [_own(camera, frame) for camera, frame in zip(cameras, frames, strict=True)]
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        notes=notes,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, own, discarded, source, options, files=files)


def _own(camera: _Camera, frame: Frame) -> Camera | None:
    size = color_size(frame.color)
    with camera_stated_in(frame.name):
        return None if size is None else Camera.from_values(camera.values, *size)


def _connected(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)


def _is_database(path: Path) -> bool:
    try:
        with closing(_connected(path)) as connection:
            names = {
                row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            }
    except sqlite3.DatabaseError:
        return False
    return {"Node", "Data"} <= names


def _has_depth(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT 1 FROM Data WHERE length(depth) > 0 LIMIT 1").fetchone() is not None


def _poses(connection: sqlite3.Connection) -> tuple[dict[int, NDArray[np.float64]], tuple[str, ...]]:
    """Return the 3x4 poses of the bases by node, and how they were read."""
    optimized = _optimized_poses(connection)
    if optimized:
        return optimized, ()
    rows = connection.execute("SELECT id, map_id, pose FROM Node WHERE pose IS NOT NULL").fetchall()
    # Each time that the odometry was lost a new map begins at its own origin.
    sizes = Counter(map_id for _, map_id, _ in rows)
    largest = max(sizes, key=lambda map_id: sizes[map_id], default=None)
    poses = {
        int(number): _matrix(pose)
        for number, map_id, pose in rows
        if isinstance(pose, bytes) and map_id == largest
    }
    return poses, (NOT_OPTIMIZED, *((NOT_JOINED.format(count=len(sizes)),) if len(sizes) > 1 else ()))


def _optimized_poses(connection: sqlite3.Connection) -> dict[int, NDArray[np.float64]]:
    try:
        row = connection.execute("SELECT opt_ids, opt_poses FROM Admin").fetchone()
    except sqlite3.OperationalError:
        return {}
    if row is None or not all(isinstance(blob, bytes) for blob in row):
        return {}
    ids = np.frombuffer(_inflated(row[0]), "<i4")
    values = np.frombuffer(_inflated(row[1]), "<f4")
    if len(values) != 12 * len(ids):
        return {}
    return {
        int(i): pose.reshape(3, 4).astype(np.float64)
        for i, pose in zip(ids, values.reshape(-1, 12), strict=True)
    }


def _inflated(blob: bytes) -> bytes:
    # Behind the compressed bytes stand rows, columns and type of the matrix.
    try:
        return zlib.decompressobj().decompress(blob, _MAX_UNPACKED_BYTES)
    except zlib.error:
        return b""


def _matrix(blob: bytes) -> NDArray[np.float64]:
    if len(blob) < 48:
        return np.full((3, 4), np.nan)
    return np.frombuffer(blob[:48], "<f4").reshape(3, 4).astype(np.float64)


def _nodes(connection: sqlite3.Connection) -> Iterator[_Node]:
    query = (
        "SELECT Node.id, Node.stamp, Data.image, Data.depth, Data.calibration FROM Node JOIN Data ON Data.id = Node.id "
        "ORDER BY Node.id"
    )
    for number, stamp, *blobs in connection.execute(query):
        color, depth, calibration = (blob if isinstance(blob, bytes) else b"" for blob in blobs)
        yield _Node(int(number), float(stamp or 0.0), color, depth, calibration)


def _frames(
    connection: sqlite3.Connection,
    name: str,
    poses: dict[int, NDArray[np.float64]],
    files: FrameFiles,
    discarded: Discarded,
    cameras: list[_Camera],
    *,
    has_depth: bool,
) -> list[Frame]:
    frames, invalid = [], []
    for node in _nodes(connection):
        label = f"{name}/{node.number:06d}"
        if not node.color:
            continue
        if has_depth and not node.depth:
            discarded.add("no_depth", label)
            continue
        if node.number not in poses:
            discarded.add("no_pose", label)
            continue
        camera = _camera(node, label)
        pose = _pose(poses[node.number])
        if pose is None:
            discarded.add("invalid_pose", label)
            invalid.append(label)
            continue
        cameras.append(camera)
        suffix = ".png" if node.color.startswith(b"\x89PNG") else ".jpg"
        color = files.write(f"color/{node.number:06d}{suffix}", node.color)
        depth = _write_depth(node, label, files) if has_depth else color
        frames.append(Frame(label, node.time_s, color, depth, pose @ camera.base_from_camera))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _pose(matrix: NDArray[np.float64]) -> Pose | None:
    try:
        return Pose.from_matrix(np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]]))
    except InvalidPoseError:
        return None


def _camera(node: _Node, label: str) -> _Camera:
    """Return a node's calibration; raises `InvalidScanError` for stereo and several cameras."""
    if len(node.calibration) in _OLD_SIZES:
        return _old_camera(node, label)
    if len(node.calibration) < _HEADER.size:
        raise InvalidScanError(f"{label} has no calibration that can be read: {EXPORT}.")
    header = _HEADER.unpack_from(node.calibration)
    counts = header[6:10]
    place_count = header[10]
    size = _HEADER.size + 8 * sum(counts) + 4 * place_count
    if header[3] != _MONO or counts[0] != 9 or min(counts) < 0 or place_count not in (0, 12):
        raise InvalidScanError(
            f"The camera of {label} is a stereo camera, or its calibration is damaged: {EXPORT}."
        )
    if len(node.calibration) != size:
        raise InvalidScanError(f"{label} has several cameras, of which one is read: {EXPORT}.")
    doubles = np.frombuffer(node.calibration, "<f8", sum(counts), _HEADER.size)
    K, D = doubles[:9], doubles[9 : 9 + counts[1]]
    values = [float(K[i]) for i in (0, 4, 2, 5)]
    if np.any(D) and counts[1] in (4, 5):
        values += D.tolist()
    elif np.any(D):
        raise InvalidScanError(
            f"The lens of {label} has {counts[1]} numbers; 4 and 5 are read: give `camera`."
        )
    place = np.eye(3, 4)
    if place_count:
        place = np.frombuffer(node.calibration, "<f4", 12, size - 48).reshape(3, 4).astype(np.float64)
    base_from_camera = _pose(place)
    if base_from_camera is None:
        raise InvalidScanError(f"The place of the camera of {label} is no rigid transform: {EXPORT}.")
    return _Camera(tuple(values), base_from_camera)


def _old_camera(node: _Node, label: str) -> _Camera:
    values = np.frombuffer(node.calibration, "<f4").astype(np.float64)
    base_from_camera = _pose(values[-12:].reshape(3, 4))
    if base_from_camera is None or not (np.isfinite(values).all() and values[:2].min() > 0):
        raise InvalidScanError(f"{label} has no calibration that can be read: {EXPORT}.")
    return _Camera(tuple(values[:4].tolist()), base_from_camera)


def _write_depth(node: _Node, label: str, files: FrameFiles) -> Path:
    """Write a node's depth: 16 bits in millimetres as PNG or RVL, or floats in metres, whose bytes stand as RGBA."""
    name = f"depth/{node.number:06d}.png"
    if node.depth.startswith(_RVL):
        return files.write_depth(name, _rvl_depth(node.depth, label))
    image = cv2.imdecode(np.frombuffer(node.depth, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InvalidScanError(f"The depth of {label} is stored neither as PNG nor as RVL: {EXPORT}.")
    if image.dtype == np.uint16 and image.ndim == 2:
        return files.write(name, node.depth)
    if image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 4:
        return files.write_depth_m(name, np.ascontiguousarray(image).view("<f4")[..., 0])
    raise InvalidScanError(f"The depth of {label} is a picture of 8 bits, which holds no depth: {EXPORT}.")


def _rvl_depth(data: bytes, label: str) -> NDArray[np.uint16]:
    width, height = _RVL_HEADER.unpack_from(data)[1:] if len(data) >= _RVL_HEADER.size else (0, 0)
    depth = None
    if 0 < width * height <= LIMITS.max_pixels:
        depth = decode_rvl(data[_RVL_HEADER.size :], width, height)
    if depth is None:
        raise InvalidScanError(f"The depth of {label} is damaged: it is no RVL image.")
    return depth
