"""COLMAP models, text or binary: `cameras`, `images`, and the folder of pictures; depth images beside it if there are.

Source of the layout: colmap.github.io/format.html. Poses are `camera_from_world`; principal points count from the
corner of the first pixel. A model has no depth and no scale of its own.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, check_pose_ratio
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.colmap_cameras import MODELS, camera_of_colmap
from app.importers.frame_files.one_camera import assemble_of_cameras
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.scan_files import numbers, read_gravity, read_text, rows, whole_numbers
from app.importers.unpacked import FrameFiles
from app.importers.unread.exports import EXPORTS

MODEL_FOLDERS = ("", "sparse/0", "sparse", "model", "colmap", "colmap/sparse/0")
# The last one is that of ScanNet++, whose model lies in `colmap`.
IMAGE_FOLDERS = ("images", "image", "rgb", "color", "input", "frames", "photos", "resized_images")
DEPTH_FOLDERS = ("depth", "depths", "depth_maps")
DEPTH_SUFFIXES = (".png", ".tiff", ".tif", ".exr", ".npy", ".pgm")
DEFAULT_DEPTH_SCALE = 1000.0
# Tools for splats leave this beside a model whose depth images a network guessed.
GUESSED_DEPTH = "depth_params.json"
OF_GUESSED_DEPTH = f"By {GUESSED_DEPTH} the depth images hold guessed inverse distances: they were not read."
NO_SCALE = "A COLMAP model has no scale of its own: poses and map are in its units."
# The files hold no times: frames follow each other by name.
FRAME_RATE_HZ = 30.0
_MAX_NAME_BYTES = 1000


@dataclass(frozen=True, slots=True)
class _Image:
    """A picture of the model: its name, its camera's number, and `camera_from_world` (None if it is no pose)."""

    name: str
    camera: int
    camera_from_world: Pose | None


def detect(directory: Path) -> bool:
    """Return whether the folder holds a model, or has one where COLMAP puts it."""
    return _model_folder(directory) is not None


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a model; without depth images its frames have none, and points are triangulated.

    Pictures of several cameras, as COLMAP has one for each picture unless it is told otherwise, become those of one.
    Raises `InvalidScanError` for cameras too different for that, missing pictures, and files that are not this.
    """
    model = _model_folder(directory)
    if model is None:
        raise InvalidScanError(
            "The scan has no COLMAP model: cameras.txt and images.txt, or cameras.bin and images.bin."
        )
    folder, files, discarded = ScanFolder(directory), FrameFiles(options.scratch), Discarded()
    cameras, images = _read_model(model)
    unknown = next((image for image in images if image.camera not in cameras), None)
    if not images or unknown is not None:
        fault = (
            "lists no pictures" if unknown is None else f"has no camera {unknown.camera} for {unknown.name}"
        )
        raise InvalidScanError(f"The COLMAP model {fault}: {EXPORTS['colmap'].remedy}.")
    is_guessed = (model / GUESSED_DEPTH).is_file()
    depth_folder = None if is_guessed else folder.subfolder(*DEPTH_FOLDERS)
    if depth_folder is not None and not holds_depth(folder):
        depth_folder = None
    frames = _frames(
        folder, images, None if depth_folder is None else folder.name_of(depth_folder), discarded
    )
    has_depth = depth_folder is not None
    source = ScanSource(
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=has_depth,
        notes=() if has_depth else (NO_SCALE, *((OF_GUESSED_DEPTH,) if is_guessed else ())),
    )
    return assemble_of_cameras(
        [item.frame for item in frames],
        [cameras[item.camera] for item in frames],
        discarded,
        source,
        options,
        files=files,
    )


def _model_folder(directory: Path) -> Path | None:
    """Return the folder of the model; of several that COLMAP leaves in `sparse`, the one with the most pictures."""
    several = sorted(directory.glob("sparse/[0-9]*/images.*"), key=lambda path: -path.stat().st_size)
    largest = [path.parent.relative_to(directory).as_posix() for path in several]
    for name in (*MODEL_FOLDERS[:1], *largest[:1], *MODEL_FOLDERS[1:]):
        for suffix in (".bin", ".txt"):
            if all((directory / name / f"{file}{suffix}").is_file() for file in ("cameras", "images")):
                return directory / name
    return None


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A frame, and the number of its camera; in a model without depth its picture stands for it."""

    frame: Frame
    camera: int


def _frames(
    folder: ScanFolder, images: list[_Image], depth_folder: str | None, discarded: Discarded
) -> list[_Candidate]:
    frames, invalid = [], []
    for number, image in enumerate(sorted(images, key=lambda image: image.name)):
        places = (f"{name}/{image.name}" for name in (*IMAGE_FOLDERS, "."))
        color = next(filter(None, (folder.find(place, "the model") for place in places)), None)
        depth = _depth(folder, depth_folder, image.name)
        if color is None:
            discarded.add(
                "missing_file", image.name, f"{image.name}; {folder.instead(f'images/{image.name}')}"
            )
        elif depth_folder is not None and depth is None:
            detail = f"{depth_folder} has no file for {image.name}"
            discarded.add("no_depth", image.name, detail)
        elif image.camera_from_world is None:
            discarded.add("invalid_pose", image.name)
            invalid.append(image.name)
        else:
            pose = image.camera_from_world.inverse()
            time_s = number / FRAME_RATE_HZ
            frame = Frame(folder.name_of(color), time_s, color, depth or color, pose)
            frames.append(_Candidate(frame, image.camera))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _depth(folder: ScanFolder, depth_folder: str | None, name: str) -> Path | None:
    if depth_folder is None:
        return None
    stem = f"{depth_folder}/{name.rpartition('.')[0]}"
    return next(
        filter(None, (folder.find(f"{stem}{suffix}", "the model") for suffix in DEPTH_SUFFIXES)), None
    )


def _read_model(model: Path) -> tuple[dict[int, Camera], list[_Image]]:
    if (model / "images.bin").is_file():
        try:
            with (model / "cameras.bin").open("rb") as cameras, (model / "images.bin").open("rb") as images:
                return _binary_cameras(cameras), _binary_images(images)
        except (struct.error, ValueError, OverflowError, IndexError):
            raise InvalidScanError(
                "The COLMAP model is damaged: cameras.bin or images.bin ends too early."
            ) from None
    return _text_cameras(read_text(model / "cameras.txt")), _text_images(read_text(model / "images.txt"))


def _text_cameras(text: str) -> dict[int, Camera]:
    cameras = {}
    for row in rows(text):
        cells, where = row.text.split(), f"cameras.txt line {row.line}"
        if len(cells) < 5 or cells[1] not in dict(MODELS):
            raise InvalidScanError(
                f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS and a model that is known."
            )
        number, width, height = whole_numbers([cells[0], *cells[2:4]], where)
        params = numbers(cells[4:], where)
        cameras[number] = camera_of_colmap(cells[1], width, height, params, where)
    return cameras


def _text_images(text: str) -> list[_Image]:
    """Return the pictures of `images.txt`: each takes two lines, the second of its points, which may be blank or, as
    other tools write models without points, not there."""
    images: list[_Image] = []
    expects_points = False
    for number, line in enumerate(text.splitlines(), start=1):
        cells = line.split(maxsplit=9)
        if cells and cells[0].startswith("#"):
            continue
        was_expected, expects_points = expects_points, False
        if not cells or (was_expected and _are_points(cells)):
            continue
        where = f"images.txt line {number}"
        if len(cells) != 10:
            raise InvalidScanError(f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME.")
        pose = _pose(numbers(cells[1:8], where))
        (camera,) = whole_numbers(cells[8:9], where)
        images.append(_Image(cells[9].rstrip(), camera, pose))
        expects_points = True
    return images


def _are_points(cells: list[str]) -> bool:
    """Whether a line begins with numbers alone, as X Y POINT3D_ID; a picture's tenth column is its name."""
    first = [*cells[:9], *(cell.split(maxsplit=1)[0] for cell in cells[9:])]
    try:
        return all(np.isfinite([float(cell) for cell in first]))
    except ValueError:
        return False


def _binary_cameras(file: BinaryIO) -> dict[int, Camera]:
    cameras = {}
    for _ in range(struct.unpack("<Q", file.read(8))[0]):
        number, model, width, height = struct.unpack("<IiQQ", file.read(24))
        if not 0 <= model < len(MODELS):
            raise InvalidScanError(f"cameras.bin: the camera model number {model} is not known.")
        name, count = MODELS[model]
        params = struct.unpack(f"<{count}d", file.read(8 * count))
        cameras[number] = camera_of_colmap(name, width, height, list(params), "cameras.bin")
    return cameras


def _binary_images(file: BinaryIO) -> list[_Image]:
    images = []
    for _ in range(struct.unpack("<Q", file.read(8))[0]):
        _, *values, camera = struct.unpack("<I7dI", file.read(64))
        name = b""
        while (byte := file.read(1)) != b"\0":
            name += byte
            if not byte or len(name) > _MAX_NAME_BYTES:
                raise InvalidScanError("The COLMAP model is damaged: images.bin has a name without an end.")
        (points,) = struct.unpack("<Q", file.read(8))
        file.seek(24 * points, 1)
        images.append(_Image(name.decode(), camera, _pose(list(values))))
    return images


def _pose(values: list[float]) -> Pose | None:
    qw, qx, qy, qz, *translation = values
    try:
        return Pose.from_quaternion(translation, [qx, qy, qz, qw])
    except InvalidPoseError:
        return None
