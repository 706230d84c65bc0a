"""Layout of Open3D and the Redwood data sets: `trajectory.log` or `.json`, `color`, `depth`, and `intrinsic.json`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frame_files.open3d_files import (
    holds_open3d_camera,
    is_open3d_trajectory,
    open3d_camera,
    open3d_trajectory,
)
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.rows.matrices import poses_of_matrices
from app.importers.scan_files import numbers, read_camera_file, read_gravity, read_text, rows

COLOR_FOLDERS = ("color", "image", "rgb", "images")
DEPTH_FOLDERS = ("depth", "depths")
INTRINSIC_FILES = (
    "intrinsic.json", "camera_intrinsic.json", "camera_intrinsics.json", "intrinsics.json", "camera.json",
)  # fmt: skip
LOG_SUFFIXES = (".log", ".txt")
DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 30.0
# Each pose takes five rows: three integers, then the matrix.
ROWS_PER_POSE = 5
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".webp", ".exr", ".npy"})


def detect(directory: Path) -> bool:
    """Return whether the folder holds a trajectory of Open3D and colour."""
    return ScanFolder(directory).subfolder(*COLOR_FOLDERS) is not None and bool(_trajectories(directory))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in Open3D's layout.

    The k-th pose of the trajectory, a `.log` file or Open3D's JSON, is that of the k-th colour image and depth image by
    name. Poses are `scan_from_camera` in a log, `camera_from_scan` in JSON; the camera is that of the options, of
    `camera.txt`, of the JSON trajectory or of `intrinsic.json`; depth is in 1000 per metre unless stated. Without any
    depth images the frames have none. Raises `InvalidScanError` for counts that differ and files that are not this.
    """
    folder = ScanFolder(directory)
    trajectories = _trajectories(directory)
    if len(trajectories) != 1:
        names = " and ".join(path.name for path in trajectories)
        raise InvalidScanError(
            f"The scan has {len(trajectories)} trajectories, {names}: send only one."
            if trajectories
            else "The scan has no .log file."
        )
    path = trajectories[0]
    is_json = path.suffix.lower() == ".json"
    poses, own_camera = open3d_trajectory(path) if is_json else (_poses(path), None)
    color, has_depth = _images(folder, COLOR_FOLDERS, "colour"), holds_depth(folder)
    depth = _images(folder, DEPTH_FOLDERS, "depth") if has_depth else color
    if not len(color) == len(depth) == len(poses):
        images = f"{len(color)} colour" + (f" and {len(depth)} depth" if has_depth else "")
        raise InvalidScanError(
            f"{path.name} has {len(poses)} poses for {images} images: poses and images are paired by their order, so "
            "send as many of each."
        )
    discarded = Discarded()
    frames = []
    for number, (image, depth_image, pose) in enumerate(zip(color, depth, poses, strict=True)):
        name = folder.name_of(image)
        if pose is None:
            discarded.add("invalid_pose", name)
        else:
            frames.append(Frame(name, number / FRAME_RATE_HZ, image, depth_image, pose))
    camera, scale = _camera(folder, options, own_camera)
    source = ScanSource(
        camera=camera,
        depth_scale=scale,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=has_depth,
    )
    return assemble_scan(frames, discarded, source, options)


def _trajectories(directory: Path) -> list[Path]:
    """Return the files that begin like a trajectory; reconstructions leave theirs in the folder `scene`."""
    folders = [directory, directory / "scene"]
    files = sorted(
        path
        for folder in folders
        if folder.is_dir()
        for path in folder.iterdir()
        if path.is_file() and not path.is_symlink() and not path.name.startswith(".")
    )
    logs = [path for path in files if path.suffix.lower() in LOG_SUFFIXES and _begins_with_a_pose(path)]
    return logs + [path for path in files if path.suffix.lower() == ".json" and is_open3d_trajectory(path)]


def _begins_with_a_pose(path: Path) -> bool:
    with path.open("rb") as file:
        lines = file.read(1000).decode("ascii", errors="replace").splitlines()[:2]
    counts = [len(line.split()) for line in lines]
    return counts == [3, 4] and all(cell.lstrip("-").isdigit() for cell in lines[0].split())


def _poses(path: Path) -> list[Pose | None]:
    lines = list(rows(read_text(path)))
    if not lines or len(lines) % ROWS_PER_POSE:
        raise InvalidScanError(
            f"{path.name} has {len(lines)} rows; each pose has {ROWS_PER_POSE}: three integers, then a 4x4 matrix."
        )
    matrices = []
    for start in range(0, len(lines), ROWS_PER_POSE):
        cells = [cell for row in lines[start + 1 : start + ROWS_PER_POSE] for cell in row.cells()]
        where = f"{path.name} line {lines[start + 1].line}"
        if len(cells) != 16:
            raise InvalidScanError(f"{where}: expected a 4x4 matrix, and found {len(cells)} numbers.")
        matrices.append(np.array(numbers(cells, where)))
    poses, _ = poses_of_matrices(matrices)
    invalid = [i for i, pose in enumerate(poses) if pose is None]
    example = f"the one at line {lines[ROWS_PER_POSE * invalid[0]].line}" if invalid else ""
    check_pose_ratio(len(invalid), len(poses), example)
    return poses


def _images(folder: ScanFolder, names: tuple[str, ...], content: str) -> list[Path]:
    found = folder.subfolder(*names)
    if found is None:
        raise InvalidScanError(f"The scan has no {content} images: the folder {names[0]} is missing.")
    return [
        path
        for path in folder.files_in(found)
        if path.suffix.lower() in IMAGE_SUFFIXES and folder.find(folder.name_of(path), "the scan") is not None
    ]


def _camera(folder: ScanFolder, options: ScanOptions, own: Camera | None) -> tuple[CameraHint, float | None]:
    """Return the camera, and the depth units per metre where a file states them."""
    stated = read_camera_file(folder.path)
    path = _intrinsic_file(folder)
    content = {} if path is None else read_json_object(path)
    scale = stated.depth_scale if stated else None
    if scale is None and path is not None and content.get("depth_scale"):
        scale = number_of(content, "depth_scale", path.name)
    if options.camera is not None:
        return options.camera, scale
    if stated is not None:
        return stated.camera, scale
    if own is not None or path is None:
        return hint_of(own or _no_camera()), scale
    return hint_of(open3d_camera(content, path.name)), scale


def _intrinsic_file(folder: ScanFolder) -> Path | None:
    """Return the JSON file with Open3D's intrinsics: by its usual names, else the only one with a matrix in it."""
    named = next(filter(None, (folder.find(name, "the scan") for name in INTRINSIC_FILES)), None)
    if named is not None:
        return named
    files = (path for path in folder.files_in(folder.path) if path.suffix.lower() == ".json")
    fitting = [path for path in files if not path.is_symlink() and holds_open3d_camera(path)]
    return fitting[0] if len(fitting) == 1 else None


def _no_camera() -> Camera:
    raise InvalidScanError(
        "The scan's camera is not known: give `camera` in the options, or add intrinsic.json with width, height "
        "and intrinsic_matrix."
    )
