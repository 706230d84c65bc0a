"""Layout of Open3D and the Redwood data sets: `trajectory.log`, `color` and `depth` folders, `intrinsic.json`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidCameraError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.folder import ScanFolder
from app.importers.frame_files.json_files import number_of, read_json_object
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.rows.matrices import poses_of_matrices
from app.importers.scan_files import numbers, read_camera_file, read_gravity, read_text, rows

COLOR_FOLDERS = ("color", "image", "rgb", "images")
DEPTH_FOLDERS = ("depth", "depths")
INTRINSIC_FILES = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera.json")
DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 30.0
# Each pose takes five rows: three integers, then the matrix.
ROWS_PER_POSE = 5
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".pgm", ".webp", ".exr", ".npy"})


def detect(directory: Path) -> bool:
    """Return whether the folder holds a `.log` trajectory, colour and depth."""
    folder = ScanFolder(directory)
    images = folder.subfolder(*COLOR_FOLDERS) and folder.subfolder(*DEPTH_FOLDERS)
    return images is not None and bool(_logs(directory))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in Open3D's layout.

    The k-th pose of the log is that of the k-th colour image and depth image by name. Poses are `scan_from_camera`;
    the camera is that of the options, of `camera.txt` or of `intrinsic.json`; depth is in 1000 per metre unless
    stated. Raises `InvalidScanError` for counts that differ and files that are not this.
    """
    folder = ScanFolder(directory)
    logs = _logs(directory)
    if len(logs) != 1:
        names = " and ".join(log.name for log in logs)
        raise InvalidScanError(
            f"The scan has {len(logs)} trajectories, {names}: send only one."
            if logs
            else "The scan has no .log file."
        )
    poses = _poses(logs[0])
    color, depth = _images(folder, COLOR_FOLDERS, "colour"), _images(folder, DEPTH_FOLDERS, "depth")
    if not len(color) == len(depth) == len(poses):
        raise InvalidScanError(
            f"{logs[0].name} has {len(poses)} poses for {len(color)} colour and {len(depth)} depth images: poses and "
            "images are paired by their order, so send as many of each."
        )
    discarded = Discarded()
    frames = []
    for number, (image, depth_image, pose) in enumerate(zip(color, depth, poses, strict=True)):
        name = folder.name_of(image)
        if pose is None:
            discarded.add("invalid_pose", name)
        else:
            frames.append(Frame(name, number / FRAME_RATE_HZ, image, depth_image, pose))
    camera_file = read_camera_file(directory)
    source = ScanSource(
        camera=options.camera or (camera_file.camera if camera_file else hint_of(_camera(folder))),
        depth_scale=camera_file.depth_scale if camera_file else None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
    )
    return assemble_scan(frames, discarded, source, options)


def _logs(directory: Path) -> list[Path]:
    """Return the files that begin like a trajectory log; reconstructions leave theirs in the folder `scene`."""
    folders = [directory, directory / "scene"]
    files = sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.[lL][oO][gG]"))
    return [path for path in files if not path.is_symlink() and path.is_file() and _begins_with_a_pose(path)]


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


def _camera(folder: ScanFolder) -> Camera:
    path = next(filter(None, (folder.find(name, "the scan") for name in INTRINSIC_FILES)), None)
    if path is None:
        raise InvalidScanError(
            "The scan's camera is not known: give `camera` in the options, or add intrinsic.json with width, height "
            "and intrinsic_matrix."
        )
    return _camera_of(read_json_object(path), path.name)


def _camera_of(content: dict[str, Any], name: str) -> Camera:
    """Return the camera of Open3D's JSON, whose matrix stands by columns."""
    values = content.get("intrinsic_matrix")
    if not isinstance(values, list) or len(values) != 9:
        raise InvalidScanError(f"{name}: intrinsic_matrix must be nine numbers, by columns.")
    K = {str(i): value for i, value in enumerate(values)}
    fx, fy, cx, cy = (number_of(K, key, f"{name}: intrinsic_matrix") for key in ("0", "4", "6", "7"))
    width, height = (int(number_of(content, key, name)) for key in ("width", "height"))
    try:
        return Camera("PINHOLE", width, height, (fx, fy, cx, cy))
    except InvalidCameraError as error:
        raise InvalidScanError(f"{name}: {error}") from None
