"""RTAB-Map's export: folders `rgb`, `depth` and `calib` (or one calibration file), and poses, by rtabmap-export.

Source of the layout: tools/Export/main.cpp of github.com/introlab/rtabmap. Poses are those of the camera in a file
whose name says so (`--poses_camera`), else those of the base; the camera's place on it is in the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.rows.trajectory_rows import parse_trajectory
from app.importers.scan_camera import camera_stated_in
from app.importers.scan_files import read_text, rows
from app.importers.unpacked import FrameFiles

DEFAULT_DEPTH_SCALE = 1000.0
# With an id in the last column, which names the pictures.
ID_COLUMNS = 9
# What a calibration that lies beside the folders has in it, and another file of settings has not.
_CAMERA = b"camera_matrix"
_HEAD_BYTES = 8192


@dataclass(frozen=True, slots=True)
class _Folders:
    color: Path
    depth: Path | None
    calibration: Path
    poses: Path


@dataclass(frozen=True, slots=True)
class _Calibration:
    values: tuple[float, ...]
    base_from_camera: Pose


def detect(directory: Path) -> bool:
    """Return whether the folder holds pictures, calibrations and poses, and a folder of depth, if any."""
    return _folders(directory) is not None


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of an export; pictures, depth and poses are paired by the node's id, else by time.

    Without any depth images the frames have none. Raises `InvalidScanError` for files that are missing or not this.
    """
    found = _folders(directory)
    if found is None:
        raise InvalidScanError("The scan has no folders rgb and calib with a file of poses beside them.")
    folder, discarded = ScanFolder(directory), Discarded()
    calibrations = _calibrations(folder, found.calibration)
    poses = _poses(found.poses)
    has_depth = holds_depth(folder)
    depth_folder = found.depth if has_depth and found.depth is not None else found.color
    depths = {path.stem: path for path in folder.files_in(depth_folder)}
    frames, cameras = [], []
    for color in folder.files_in(found.color):
        name, row = folder.name_of(color), poses.get(_key(color.stem))
        if color.stem not in calibrations and f"{color.stem}_1" in calibrations:
            raise InvalidScanError(
                f"{color.name} is of several cameras, by {color.stem}_0.yaml, {color.stem}_1.yaml and so on: export a "
                "map that was made with one camera."
            )
        calibration = calibrations.get(color.stem) or next(iter(calibrations.values()))
        if color.stem not in depths:
            detail = f"{depth_folder.name} has no file {color.stem}"
            discarded.add("no_depth", name, detail)
        elif row is None:
            discarded.add("no_pose", name, f"{found.poses.name} has no row for {color.name}")
        else:
            time_s, pose = row
            place = Pose.identity() if "camera" in found.poses.name else calibration.base_from_camera
            frames.append(Frame(name, time_s, color, depths[color.stem], pose @ place))
            cameras.append(_camera(calibration, frames[-1]))
    files = FrameFiles(options.scratch)
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _calibrations(folder: ScanFolder, found: Path) -> dict[str, _Calibration]:
    """Return the calibrations by the pictures' names; one that old versions write for all stands under its own name."""
    paths = folder.files_in(found) if found.is_dir() else [found]
    paths = [path for path in paths if _is_yaml(path)]
    if not paths:
        raise InvalidScanError(f"The scan's camera is not known: {found.name} holds no .yaml file.")
    return {path.stem: _calibration(path) for path in paths}


def _camera(calibration: _Calibration, frame: Frame) -> Camera | None:
    """Return the camera of a frame, None for a picture that can't be read."""
    size = color_size(frame.color)
    with camera_stated_in(frame.name):
        return None if size is None else Camera.from_values(calibration.values, *size)


def _is_yaml(path: Path) -> bool:
    return path.suffix.lower() in (".yaml", ".yml")


def _is_calibration(path: Path) -> bool:
    if not path.is_file() or path.is_symlink() or not _is_yaml(path):
        return False
    with path.open("rb") as file:
        return _CAMERA in file.read(_HEAD_BYTES)


def _folders(directory: Path) -> _Folders | None:
    below = sorted(child for child in directory.iterdir() if child.is_dir() and not child.is_symlink())
    found = {
        end: [child for child in below if child.name.lower().endswith(end)]
        for end in ("rgb", "depth", "calib")
    }
    poses = sorted(
        path for path in directory.iterdir() if path.is_file() and path.name.lower().endswith("poses.txt")
    )
    # The camera's own poses come first where both were exported.
    poses.sort(key=lambda path: "camera" not in path.name)
    if not found["calib"]:
        files = sorted(path for path in directory.iterdir() if _is_calibration(path))
        found["calib"] = files if len(files) == 1 else []
    depth = found.pop("depth")
    if not poses or any(len(folders) != 1 for folders in found.values()) or len(depth) > 1:
        return None
    return _Folders(found["rgb"][0], depth[0] if depth else None, found["calib"][0], poses[0])


def _key(text: str) -> str:
    """Return what a file's stem and a row's id or time have in common."""
    try:
        return f"{float(text):.6f}"
    except ValueError:
        return text


def _poses(path: Path) -> dict[str, tuple[float, Pose]]:
    """Return time and pose of each row by its id where the rows have one, and by its time."""
    text = read_text(path)
    table = parse_trajectory(text, path.name).values
    if np.isnan(table[:, 0]).all():
        raise InvalidScanError(
            f"{path.name} names neither times nor pictures: export it with rtabmap-export --images_id --poses_camera "
            "--poses_format 11."
        )
    # A header that names the columns in words is a comment in these files.
    cells = [row.cells() for row in rows(text)]
    ids = [row[-1] for row in cells if len(row) == ID_COLUMNS]
    poses: dict[str, tuple[float, Pose]] = {}
    for i, values in enumerate(table):
        if not np.isfinite(values).all():
            continue
        entry = float(values[0]), Pose.from_quaternion(values[1:4], values[4:8])
        poses[_key(str(float(values[0])))] = entry
        if len(ids) == len(table):
            poses.setdefault(_key(ids[i]), entry)
    return poses


def _calibration(path: Path) -> _Calibration:
    # OpenCV's reader raises for text that is no YAML of its kind.
    try:
        storage = cv2.FileStorage(read_text(path), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        K, D, place = (
            _numbers_of(storage, key)
            for key in ("camera_matrix", "distortion_coefficients", "local_transform")
        )
    except (cv2.error, SystemError):
        raise InvalidScanError(f"{path.name} is not a calibration in OpenCV's YAML.") from None
    if len(K) != 9:
        raise InvalidScanError(f"{path.name} holds no camera_matrix of nine numbers.")
    values = tuple(float(K[i]) for i in (0, 4, 2, 5))
    if np.any(D) and len(D) in (4, 5):
        values += tuple(D.tolist())
    matrix = np.vstack([place.reshape(3, 4) if len(place) == 12 else np.eye(3, 4), [0.0, 0.0, 0.0, 1.0]])
    try:
        return _Calibration(values, Pose.from_matrix(matrix))
    except InvalidPoseError:
        raise InvalidScanError(f"{path.name}: local_transform is no rigid transform.") from None


def _numbers_of(storage: cv2.FileStorage, key: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    data = storage.getNode(key).getNode("data")
    return np.array([data.at(i).real() for i in range(data.size())] if data.isSeq() else [])
