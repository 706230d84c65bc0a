"""ARKitScenes: `lowres_wide`, `lowres_depth`, `confidence`, `lowres_wide_intrinsics` and `lowres_wide.traj`.

Source of the layout: DATA.md of github.com/apple/ARKitScenes. The trajectory has rows `timestamp rx ry rz tx ty tz`, an
axis-angle vector and a translation of `camera_from_world`; the world's z is up.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose, rotation_from_vector
from app.importers.assembly import Discarded, ScanSource
from app.importers.association import Trajectory
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.phones.arkit import confidence_files
from app.importers.scan_camera import camera_stated_in
from app.importers.scan_files import numbers, read_text, rows
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import lacking

# The data set has the pictures in three sizes; the smallest is that of the depth images.
COLORS = ("lowres_wide", "vga_wide", "wide")
DEPTH = "lowres_depth"
CONFIDENCE = "confidence"
TRAJECTORY = "lowres_wide.traj"
DOWN = (0.0, 0.0, -1.0)
DEFAULT_DEPTH_SCALE = 1000.0
# The trajectory has ten poses a second, the pictures come up to 60 times: poses between two that are no further apart
# than this, one lost on the way, are interpolated.
MAX_POSE_GAP_S = 0.25
_NAMED_BY_TIME = re.compile(r".*?(\d+\.\d+)\.(?:png|jpe?g)$", re.IGNORECASE)


def detect(directory: Path) -> bool:
    """Return whether the folder holds a folder of the data set's pictures, and its depth or its trajectory."""
    has_pictures = any((directory / name).is_dir() for name in COLORS)
    return has_pictures and ((directory / DEPTH).is_dir() or (directory / TRAJECTORY).is_file())


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of one recording of the data set; pictures are paired with depth by name, with poses by time.

    Without any depth images the frames have none. Raises `InvalidScanError` for files that are missing or not this.
    """
    folder = ScanFolder(directory)
    trajectory = _trajectory(folder)
    colors = next((name for name in COLORS if (directory / name).is_dir()), COLORS[0])
    discarded, has_depth = Discarded(), holds_depth(folder)
    frames = []
    for color in folder.files_in(directory / colors):
        match = _NAMED_BY_TIME.fullmatch(color.name)
        if match is None:
            continue
        name = folder.name_of(color)
        depth = folder.find(f"{DEPTH}/{color.stem}.png", "the scan") if has_depth else color
        time_s = float(match.group(1))
        pose = trajectory.pose_between(time_s, MAX_POSE_GAP_S, options.max_time_difference_s)
        if depth is None:
            missing = f"{DEPTH}/{color.stem}.png"
            discarded.add("no_depth", name, f"{missing} is missing; {folder.instead(missing)}")
        elif isinstance(pose, str):
            discarded.add(pose, name)
        else:
            frames.append(Frame(name, time_s, color, depth, pose))
    files, confidence = FrameFiles(options.scratch), confidence_files(folder, DEPTH, CONFIDENCE)
    cameras = [] if options.camera else _cameras(folder, f"{colors}_intrinsics", frames)
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=DOWN,
        confidence=confidence,
        has_depth=has_depth,
    )
    return assemble_of_cameras(frames, cameras, discarded, source, options, files=files)


def _trajectory(folder: ScanFolder) -> Trajectory:
    path = folder.find(TRAJECTORY, "the scan")
    if path is None:
        raise lacking("arkitscenes", TRAJECTORY, "its camera poses")
    table = []
    for row in rows(read_text(path)):
        values = numbers(row.cells(), f"{path.name} line {row.line}")
        if len(values) != 7:
            raise InvalidScanError(
                f"{path.name} line {row.line}: expected 7 columns, time rx ry rz tx ty tz, and found {len(values)}."
            )
        table.append(_row(values))
    if not table:
        raise InvalidScanError(f"The scan has no camera poses: {TRAJECTORY} lists none.")
    return Trajectory.from_rows(np.array(table))


def _row(values: list[float]) -> NDArray[np.float64]:
    """Return `t x y z qx qy qz qw` of `scan_from_camera`, NaN for a row that holds no pose."""
    if not np.isfinite(values).all():
        return np.array([values[0], *[np.nan] * 7])
    pose = Pose(rotation_from_vector(values[1:4]), np.array(values[4:7])).inverse()
    return np.array([values[0], *pose.translation, *pose.quaternion])


def _cameras(folder: ScanFolder, name: str, frames: list[Frame]) -> list[Camera | None]:
    """Return the camera of each frame: by the file of its name, else, as times are rounded differently, the median."""
    files = [] if not (folder.path / name).is_dir() else folder.files_in(folder.path / name)
    files = [path for path in files if path.suffix.lower() == ".pincam"]
    if not files:
        raise lacking("arkitscenes", f"{name} with its .pincam files", "the camera's intrinsics")
    each = {path.stem: _of_file(path) for path in files}
    median = sorted(each.values(), key=lambda camera: camera.params[0])[len(each) // 2]
    return [each.get(frame.color.stem, median) for frame in frames]


def _of_file(path: Path) -> Camera:
    values = numbers([cell for row in rows(read_text(path)) for cell in row.cells()], path.name)
    if len(values) != 6 or not np.isfinite(values).all():
        raise InvalidScanError(f"{path.name} must hold six numbers: width height fx fy cx cy.")
    with camera_stated_in(path.name):
        return Camera("PINHOLE", int(values[0]), int(values[1]), tuple(values[2:]))
