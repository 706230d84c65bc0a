"""Record3D: a `.r3d` file, which is a zip of `metadata` (JSON) and `rgbd/0.jpg`, `0.depth`, `0.conf`; its EXR export.

The layout was taken from the app's documentation of its formats (record3d.app) and the recordings' own metadata:
depth and confidence are compressed by LZFSE or stored plainly. Poses are ARKit's, with quaternions x y z w first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, attitude_difference_rad, rotation_from_quaternion
from app.importers.archives.archive import extract_archive
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import LOW_CONFIDENCE, Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.phones.arkit import ARKIT_DOWN, pose_of_arkit
from app.importers.phones.lzfse_data import unpacked_data, values_in
from app.importers.recordings.files import recordings_in
from app.importers.scan_camera import camera_stated_in
from app.importers.scan_files import optional_file
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import lacking

METADATA = ("metadata", "metadata.json")
RECORDING_SUFFIX = ".r3d"
# Colour and depth of the recording itself, and of the app's export of EXR images.
COLOR_FOLDERS = ("rgbd", "rgb", "RGB", "color")
DEPTH_FOLDERS = ("depth", "Depth")
EXPORTED_SUFFIXES = (".exr", ".tiff", ".png", ".npy")
DEFAULT_DEPTH_SCALE = 1000.0
DEFAULT_FPS = 60.0
# A first pose turned by less than this is none: no phone is held so exactly.
NO_TURN_RAD = 1e-3
DOWN_UNKNOWN = "The recording counts its poses from its first picture: which way is down is thus not known."
# Depth of LiDAR and of the Face ID camera as the app records them, held sideways; old versions don't state the size.
DEPTH_SIZES = ((256, 192), (640, 480), (960, 720))


@dataclass(frozen=True, slots=True)
class _Recording:
    """The folder of an unpacked recording and its metadata."""

    folder: ScanFolder
    metadata: dict[str, Any]

    def depth_size(self, depth: Path, color: Path) -> tuple[int, int]:
        """Return width and height of the depth images: as the metadata says, else by the size of one of them."""
        if all(key in self.metadata for key in ("dw", "dh")):
            width, height = (int(number_of(self.metadata, key, "metadata")) for key in ("dw", "dh"))
            return width, height
        count = values_in(depth, np.dtype("<f4"), max(width * height for width, height in DEPTH_SIZES))
        fitting = next((size for size in DEPTH_SIZES if size[0] * size[1] == count), None)
        if fitting is None:
            raise InvalidScanError(
                f"The metadata of the recording states no size of its depth (dw, dh), and {depth.name} holds {count} "
                "values, which is none of the sizes that Record3D records."
            )
        picture = color_size(color) or fitting
        return fitting if picture[0] >= picture[1] else (fitting[1], fitting[0])


def detect(directory: Path) -> bool:
    """Return whether the folder holds a `.r3d` file, or the files of one."""
    return bool(recordings_in(directory, RECORDING_SUFFIX)) or _is_unpacked(directory)


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a recording.

    Depth of another size than the colour images has the same field of view; what has low confidence is left out.
    Without any depth the frames have none. Gravity is the world's -y, as ARKit measures it, unless the app has turned
    the world to the first picture. Raises `InvalidScanError` for files that are missing or not this.
    """
    files, discarded = FrameFiles(options.scratch), Discarded()
    recording = _opened(directory, files)
    has_depth = holds_depth(recording.folder)
    frames = _frames(recording, files, discarded, has_depth)
    cameras = [_camera(recording.metadata, frame) for frame in frames] if options.camera is None else []
    is_turned = _is_turned_to_first_picture(recording.metadata)
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=None if is_turned else ARKIT_DOWN,
        notes=(DOWN_UNKNOWN,) if is_turned else (),
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _is_turned_to_first_picture(metadata: Mapping[str, Any]) -> bool:
    """Return whether the first pose has no rotation, or the app states one that leads from its world to ARKit's.

    Versions differ: some count poses from the first picture, others leave ARKit's as they are.
    """
    poses, stated = metadata.get("poses"), metadata.get("initPose")
    first = _pose(poses[0]) if isinstance(poses, list) and poses else None
    unturned = pose_of_arkit(np.eye(4))
    if first is None or unturned is None:
        return False
    initial = _pose(stated) if isinstance(stated, list) and len(stated) == 7 else None
    # A stated pose that the first one has as well was not taken out of it.
    is_taken_out = (
        initial is not None and not _are_alike(initial, unturned) and not _are_alike(initial, first)
    )
    return is_taken_out or _are_alike(first, unturned)


def _are_alike(a: Pose, b: Pose) -> bool:
    return attitude_difference_rad(a, b) < NO_TURN_RAD


def _is_unpacked(directory: Path) -> bool:
    has_metadata = any(optional_file(directory, name) is not None for name in METADATA)
    return has_metadata and ScanFolder(directory).subfolder(*COLOR_FOLDERS) is not None


def _opened(directory: Path, files: FrameFiles) -> _Recording:
    recordings = recordings_in(directory, RECORDING_SUFFIX)
    if len(recordings) > 1:
        names = " and ".join(path.name for path in recordings[:2])
        raise InvalidScanError(f"The scan has {len(recordings)} recordings, {names}: send only one.")
    folder = _extracted(recordings[0], files) if recordings else directory
    path = next(filter(None, (optional_file(folder, name) for name in METADATA)), None)
    if path is None:
        raise lacking("record3d", "metadata", "its camera and poses")
    return _Recording(ScanFolder(folder), read_json_object(path))


def _extracted(path: Path, files: FrameFiles) -> Path:
    try:
        return extract_archive(path, files.path / "r3d")
    except InvalidScanError:
        raise InvalidScanError(
            f"{path.name} is not a recording of Record3D, which is an archive, or it is damaged: copy it again."
        ) from None


def _frames(recording: _Recording, files: FrameFiles, discarded: Discarded, has_depth: bool) -> list[Frame]:
    folder, metadata = recording.folder, recording.metadata
    color_folder = folder.subfolder(*COLOR_FOLDERS)
    poses = metadata.get("poses")
    if color_folder is None or not isinstance(poses, list):
        raise InvalidScanError("The recording has no folder rgbd, or no list of poses in its metadata.")
    if len(poses) > 1 and all(pose == poses[0] for pose in poses):
        raise InvalidScanError(
            "All poses of the recording are the same: Record3D follows the phone's way only with the LiDAR at its "
            "back, so record with that, not with the Face ID camera, and walk."
        )
    pictures = {
        int(path.stem): path
        for path in folder.files_in(color_folder)
        if path.stem.isdigit() and path.suffix.lower() in (".jpg", ".jpeg", ".png")
    }
    frames, invalid = [], []
    for number, color in sorted(pictures.items()):
        name = folder.name_of(color)
        pose = _pose(poses[number]) if number < len(poses) else None
        depth = _depth(recording, color, number, files) if has_depth else color
        if number >= len(poses):
            discarded.add("no_pose", name, f"the metadata has {len(poses)} poses, none for {name}")
        elif pose is None:
            discarded.add("invalid_pose", name)
            invalid.append(name)
        elif depth is None:
            discarded.add("no_depth", name, f"{number}.depth is missing")
        else:
            frames.append(Frame(name, _time_s(metadata, number), color, depth, pose))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _depth(recording: _Recording, color: Path, number: int, files: FrameFiles) -> Path | None:
    """Return a frame's depth image: that of the EXR export, or the recording's, written as PNG."""
    folder = recording.folder
    exported = folder.subfolder(*DEPTH_FOLDERS)
    if exported is not None:
        stem = f"{folder.name_of(exported)}/{number}"
        found = (folder.find(f"{stem}{suffix}", "the scan") for suffix in EXPORTED_SUFFIXES)
        return next(filter(None, found), None)
    stem = f"{folder.name_of(color.parent)}/{number}"
    path, confidence = (folder.find(f"{stem}.{suffix}", "the scan") for suffix in ("depth", "conf"))
    if path is None:
        return None
    width, height = recording.depth_size(path, color)
    depth_m = unpacked_data(path, np.dtype("<f4"), (height, width)).astype(np.float32)
    if confidence is not None:
        depth_m[unpacked_data(confidence, np.dtype(np.uint8), (height, width)) == LOW_CONFIDENCE] = 0.0
    return files.write_depth_m(f"depth/{number:06d}.png", depth_m)


def _time_s(metadata: Mapping[str, Any], number: int) -> float:
    times = metadata.get("frameTimestamps")
    if isinstance(times, list) and number < len(times) and isinstance(times[number], int | float):
        return float(times[number])
    fps = metadata.get("fps")
    return number / (float(fps) if isinstance(fps, int | float) and fps > 0 else DEFAULT_FPS)


def _pose(values: object) -> Pose | None:
    try:
        row = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        row = np.zeros(0)
    if row.shape != (7,):
        raise InvalidScanError("metadata: each of the poses must be seven numbers, qx qy qz qw tx ty tz.")
    norm = float(np.linalg.norm(row[:4]))
    if not np.isfinite(row).all() or norm < 1e-6:
        return None
    matrix = np.eye(4)
    x, y, z, w = (row[:4] / norm).tolist()
    try:
        matrix[:3, :3] = rotation_from_quaternion(x, y, z, w)
    except InvalidPoseError:
        return None
    matrix[:3, 3] = row[4:]
    return pose_of_arkit(matrix)


def _camera(metadata: Mapping[str, Any], frame: Frame) -> Camera | None:
    """Return the camera of a frame's picture: by the frame's own intrinsics, else by the matrix K; None for a picture
    that can't be read."""
    number, size = int(frame.color.stem), color_size(frame.color)
    each = metadata.get("perFrameIntrinsicCoeffs")
    if (
        isinstance(each, list)
        and number < len(each)
        and isinstance(each[number], list)
        and len(each[number]) >= 4
    ):
        row = dict(enumerate(each[number]))
        fx, fy, cx, cy = (number_of({str(i): row[i] for i in row}, str(i), "metadata") for i in range(4))
    else:
        fx, fy, cx, cy = _of_matrix(metadata)
    width, height = (
        float(value) if isinstance(value := metadata.get(key), int | float) and value > 0 else None
        for key in ("w", "h")
    )
    if size is None:
        return None
    if width is None:
        return _pinhole(size, (fx, fy, cx, cy))
    if height is not None and (size[0] > size[1]) != (width > height):
        raise InvalidScanError(
            f"The pictures of the recording have {size[0]} x {size[1]} pixels, and its metadata is for {width:.0f} x "
            f"{height:.0f}: they were turned, so send the .r3d file as the app writes it."
        )
    ratio = size[0] / width
    return _pinhole(size, (fx * ratio, fy * ratio, (cx + 0.5) * ratio - 0.5, (cy + 0.5) * ratio - 0.5))


def _pinhole(size: tuple[int, int], values: tuple[float, ...]) -> Camera:
    with camera_stated_in("metadata"):
        return Camera("PINHOLE", *size, values)


def _of_matrix(metadata: Mapping[str, Any]) -> tuple[float, float, float, float]:
    try:
        K: NDArray[np.float64] = np.array(metadata.get("K"), dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError, OverflowError):
        raise InvalidScanError("metadata: K must be nine numbers, the camera's matrix by columns.") from None
    # By columns, as the app writes it; a copy by rows has its last row at the end.
    K = K if np.any(K[:2, 2]) else K.T
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
