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
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose, rotation_from_quaternion
from app.importers.archives.archive import extract_archive
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.cameras import common_intrinsics
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frames import LOW_CONFIDENCE, Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.phones.arkit import ARKIT_DOWN, pose_of_arkit
from app.importers.phones.lzfse_data import unpacked_data
from app.importers.scan_files import optional_file
from app.importers.unpacked import FrameFiles

METADATA = ("metadata", "metadata.json")
RECORDING_SUFFIX = ".r3d"
# Colour and depth of the recording itself, and of the app's export of EXR images.
COLOR_FOLDERS = ("rgbd", "rgb", "RGB", "color")
DEPTH_FOLDERS = ("depth", "Depth")
DEFAULT_DEPTH_SCALE = 1000.0
DEFAULT_FPS = 60.0


@dataclass(frozen=True, slots=True)
class _Recording:
    """The folder of an unpacked recording and its metadata."""

    folder: ScanFolder
    metadata: dict[str, Any]

    @property
    def depth_size(self) -> tuple[int, int]:
        """Width and height of the depth images."""
        return tuple(int(number_of(self.metadata, key, "metadata")) for key in ("dw", "dh"))  # type: ignore[return-value]


def detect(directory: Path) -> bool:
    """Return whether the folder holds a `.r3d` file, or the files of one."""
    return bool(_recordings(directory)) or _is_unpacked(directory)


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a recording.

    Depth of another size than the colour images has the same field of view; what has low confidence is left out.
    Gravity is the world's -y, as ARKit measures it. Raises `InvalidScanError` for files that are missing or not this.
    """
    files, discarded = FrameFiles(options.scratch), Discarded()
    recording = _opened(directory, files)
    frames = _frames(recording, files, discarded)
    source = ScanSource(
        camera=options.camera or CameraHint(values=_intrinsics(recording.metadata, frames)),
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=ARKIT_DOWN,
        keeps=files,
    )
    return assemble_scan(frames, discarded, source, options)


def _recordings(directory: Path) -> list[Path]:
    return sorted(
        path
        for path in directory.iterdir()
        if path.suffix.lower() == RECORDING_SUFFIX and path.is_file() and not path.is_symlink()
    )


def _is_unpacked(directory: Path) -> bool:
    has_metadata = any(optional_file(directory, name) is not None for name in METADATA)
    return has_metadata and ScanFolder(directory).subfolder(*COLOR_FOLDERS) is not None


def _opened(directory: Path, files: FrameFiles) -> _Recording:
    recordings = _recordings(directory)
    if len(recordings) > 1:
        names = " and ".join(path.name for path in recordings[:2])
        raise InvalidScanError(f"The scan has {len(recordings)} recordings, {names}: send only one.")
    folder = _extracted(recordings[0], files) if recordings else directory
    path = next(filter(None, (optional_file(folder, name) for name in METADATA)), None)
    if path is None:
        raise InvalidScanError("The recording has no file `metadata`, so it is not one of Record3D.")
    return _Recording(ScanFolder(folder), read_json_object(path))


def _extracted(path: Path, files: FrameFiles) -> Path:
    try:
        return extract_archive(path, files.path / "r3d")
    except InvalidScanError:
        raise InvalidScanError(
            f"{path.name} is not a recording of Record3D, which is an archive, or it is damaged: copy it again."
        ) from None


def _frames(recording: _Recording, files: FrameFiles, discarded: Discarded) -> list[Frame]:
    folder, metadata = recording.folder, recording.metadata
    color_folder = folder.subfolder(*COLOR_FOLDERS)
    poses = metadata.get("poses")
    if color_folder is None or not isinstance(poses, list):
        raise InvalidScanError("The recording has no folder rgbd, or no list of poses in its metadata.")
    pictures = {
        int(path.stem): path
        for path in folder.files_in(color_folder)
        if path.stem.isdigit() and path.suffix.lower() in (".jpg", ".jpeg", ".png")
    }
    frames, invalid = [], []
    for number, color in sorted(pictures.items()):
        name = folder.name_of(color)
        pose = _pose(poses[number]) if number < len(poses) else None
        depth = _depth(recording, color_folder, number, files)
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


def _depth(recording: _Recording, color_folder: Path, number: int, files: FrameFiles) -> Path | None:
    """Return a frame's depth image: that of the EXR export, or the recording's, written as PNG."""
    folder = recording.folder
    exported = folder.subfolder(*DEPTH_FOLDERS)
    if exported is not None:
        return folder.find(f"{folder.name_of(exported)}/{number}.exr", "the scan")
    stem = f"{folder.name_of(color_folder)}/{number}"
    path, confidence = (folder.find(f"{stem}.{suffix}", "the scan") for suffix in ("depth", "conf"))
    if path is None:
        return None
    width, height = recording.depth_size
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


def _intrinsics(metadata: Mapping[str, Any], frames: list[Frame]) -> tuple[float, ...]:
    """Return the intrinsics for the pictures' size: the median of the frames' own, else the matrix K."""
    each = metadata.get("perFrameIntrinsicCoeffs")
    if isinstance(each, list) and each and all(isinstance(row, list) and len(row) >= 4 for row in each):
        rows = [tuple(number_of(dict(enumerate(row)), i, "metadata") for i in range(4)) for row in each]  # type: ignore[arg-type]
        values = common_intrinsics(rows, [f"frame {i}" for i in range(len(rows))])
    else:
        values = _of_matrix(metadata)
    size = color_size(frames[0].color) if frames else None
    width = metadata.get("w")
    if size is None or not isinstance(width, int | float) or width <= 0:
        return values
    ratio = size[0] / float(width)
    fx, fy, cx, cy = values
    return fx * ratio, fy * ratio, (cx + 0.5) * ratio - 0.5, (cy + 0.5) * ratio - 0.5


def _of_matrix(metadata: Mapping[str, Any]) -> tuple[float, float, float, float]:
    try:
        K: NDArray[np.float64] = np.array(metadata.get("K"), dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError, OverflowError):
        raise InvalidScanError("metadata: K must be nine numbers, the camera's matrix by columns.") from None
    # By columns, as the app writes it; a copy by rows has its last row at the end.
    K = K if np.any(K[:2, 2]) else K.T
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
