"""ScanNet's recordings (`.sens`): one binary file with cameras, poses, compressed colour and depth of all frames.

Source of the layout: SensReader of github.com/ScanNet/ScanNet, version 4 of the format.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.depth_files import LIMITS
from app.importers.recordings.files import recordings_in, the_recording
from app.importers.unpacked import FrameFiles

SUFFIX = ".sens"
VERSION = 4
FRAME_RATE_HZ = 30.0
MICROSECONDS_PER_S = 1e6
DEFAULT_DEPTH_SCALE = 1000.0
COLOR_SUFFIXES = {1: ".png", 2: ".jpg"}
RAW_DEPTH = 0
ZLIB_DEPTH = 1
_MAX_NAME_BYTES = 4096
_MAX_FRAMES = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    """What the file says before its frames; sizes are (width, height), matrices 4x4."""

    intrinsics: NDArray[np.float64]
    depth_intrinsics: NDArray[np.float64]
    apart: bool
    color_compression: int
    depth_compression: int
    depth_size: tuple[int, int]
    depth_scale: float
    frames: int


def detect(directory: Path) -> bool:
    """Return whether the folder holds a `.sens` file."""
    return bool(recordings_in(directory, SUFFIX))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a recording: pictures as they are stored, depth as PNG, both in a folder of their own.

    Poses are `scan_from_camera`; `-inf` stands for lost tracking. If no frame has depth, the scan has none. Raises
    `InvalidScanError` for another version or compression, and for a file that is damaged or cut short.
    """
    path = the_recording(directory, SUFFIX)
    files, discarded = FrameFiles(options.scratch), Discarded()
    with path.open("rb") as file:
        header = _read_header(file, path.name)
        frames = _frames(file, header, path.name, files, discarded)
    with_depth = [frame for frame in frames if frame.depth != frame.color]
    has_depth = bool(with_depth)
    if has_depth:
        for frame in frames:
            if frame.depth == frame.color:
                discarded.add("no_depth", frame.name)
        frames = with_depth
    if has_depth and header.apart and options.color_from_depth is None:
        raise InvalidScanError(
            f"{path.name} says that colour and depth camera are apart: give depth_camera and color_from_depth."
        )
    source = ScanSource(
        camera=options.camera or _camera(header.intrinsics),
        depth_camera=_camera(header.depth_intrinsics) if has_depth else None,
        depth_scale=header.depth_scale if has_depth else None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        has_depth=has_depth,
        keeps=files,
    )
    return assemble_scan(frames, discarded, source, options)


def _frames(
    file: BinaryIO, header: _Header, name: str, files: FrameFiles, discarded: Discarded
) -> list[Frame]:
    """Return the frames with a pose; the picture of one without depth stands for that."""
    frames, invalid = [], []
    for number in range(header.frames):
        matrix = _floats(file, 16, name).reshape(4, 4)
        time_us, _, color_bytes, depth_bytes = struct.unpack("<4Q", _bytes(file, 32, name))
        color, packed = _bytes(file, color_bytes, name), _bytes(file, depth_bytes, name)
        label = f"{name}/{number:06d}"
        try:
            pose = Pose.from_matrix(matrix)
        except InvalidPoseError:
            discarded.add("invalid_pose", label)
            invalid.append(label)
            continue
        suffix = COLOR_SUFFIXES[header.color_compression]
        time_s = time_us / MICROSECONDS_PER_S if time_us else number / FRAME_RATE_HZ
        color_path = files.write(f"color/{number:06d}{suffix}", color)
        depth_path = color_path
        if packed:
            _check_depth(header, name)
            depth_path = files.write_depth(f"depth/{number:06d}.png", _depth(packed, header, label))
        frames.append(Frame(label, time_s, color_path, depth_path, pose))
    check_pose_ratio(len(invalid), header.frames, f"that of {invalid[0]}" if invalid else "")
    return frames


def _check_depth(header: _Header, name: str) -> None:
    """Raise for depth that can't be read; what the header of a recording without any says of it means nothing."""
    if header.depth_compression not in (RAW_DEPTH, ZLIB_DEPTH):
        raise InvalidScanError(f"{name} holds depth in a compression that is not read: plain and zlib are.")
    if 0 in header.depth_size:
        width, height = header.depth_size
        raise InvalidScanError(f"{name} is damaged: it holds depth of {width} x {height} pixels.")
    if not 0 < header.depth_scale < np.inf:
        raise InvalidScanError(f"{name} is damaged: its depth has {header.depth_scale} units per metre.")


def _depth(packed: bytes, header: _Header, label: str) -> NDArray[np.uint16]:
    width, height = header.depth_size
    expected = 2 * width * height
    try:
        data = packed
        if header.depth_compression == ZLIB_DEPTH:
            data = zlib.decompressobj().decompress(packed, expected + 1)
    except zlib.error:
        data = b""
    if len(data) != expected:
        raise InvalidScanError(
            f"The depth of {label} is damaged: it is not {width} x {height} values of 16 bits."
        )
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _read_header(file: BinaryIO, name: str) -> _Header:
    version, length = struct.unpack("<IQ", _bytes(file, 12, name))
    if version != VERSION:
        raise InvalidScanError(
            f"{name} has version {version} of the .sens format; version {VERSION} is read."
        )
    if length > _MAX_NAME_BYTES:
        raise InvalidScanError(f"{name} is damaged: the name of its sensor has {length} bytes.")
    _bytes(file, length, name)
    color, color_place, depth, depth_place = (_floats(file, 16, name).reshape(4, 4) for _ in range(4))
    color_compression, depth_compression = struct.unpack("<2i", _bytes(file, 8, name))
    _, _, depth_width, depth_height = struct.unpack("<4I", _bytes(file, 16, name))
    (depth_scale,) = struct.unpack("<f", _bytes(file, 4, name))
    (count,) = struct.unpack("<Q", _bytes(file, 8, name))
    if color_compression not in COLOR_SUFFIXES:
        raise InvalidScanError(
            f"{name} holds colour without compression, which is not read: JPEG and PNG are."
        )
    if depth_width * depth_height > LIMITS.max_pixels or not 0 < count <= _MAX_FRAMES:
        raise InvalidScanError(
            f"{name} is damaged: it lists {count} frames of {depth_width} x {depth_height} pixels."
        )
    return _Header(
        intrinsics=color,
        depth_intrinsics=depth,
        apart=not np.allclose(color_place, depth_place, atol=1e-4),
        color_compression=color_compression,
        depth_compression=depth_compression,
        depth_size=(depth_width, depth_height),
        depth_scale=float(depth_scale),
        frames=count,
    )


def _camera(K: NDArray[np.float64]) -> CameraHint:
    return CameraHint(values=(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])))


def _floats(file: BinaryIO, count: int, name: str) -> NDArray[np.float64]:
    return np.frombuffer(_bytes(file, 4 * count, name), "<f4").astype(np.float64)


def _bytes(file: BinaryIO, count: int, name: str) -> bytes:
    data = file.read(min(count, 2**31))
    if len(data) != count:
        raise InvalidScanError(f"{name} is cut short: copy it again.")
    return data
