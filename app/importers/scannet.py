"""ScanNet as its exporter writes it: `color/0.jpg`, `depth/0.png`, `pose/0.txt` and the folder `intrinsic`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.pose_files import read_pose_files
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.scan_files import numbers, read_gravity, read_text, rows
from app.limits import limit

DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanNetOptions:
    """When images and intrinsics don't belong together."""

    max_principal_offset_ratio: float = limit(
        0.2,
        "How far the principal point may be from the middle of the image, over half its size.",
        chosen="By hand: real ones are within 0.05; images resized from 1296 to 640 pixels give 1.0.",
    )


OPTIONS = ScanNetOptions()
_NUMBERED = re.compile(r"(\d{1,9})\.(?:jpe?g|png)$", re.IGNORECASE)
# The folders beside the colour images, with the suffixes of their files.
_DEPTHS = ("depth", (".png", ".pgm", ".tiff", ".npy"))
_POSES = ("pose", (".txt",))
# Where the exporter, and the data set of 25,000 frames, have a camera's matrix.
_INTRINSICS = ("intrinsic/intrinsic_{}.txt", "intrinsics_{}.txt", "intrinsic_{}.txt")


def detect(directory: Path) -> bool:
    """Return whether the folder holds folders of numbered pictures and poses, and such a folder of depth, if any."""
    folder = ScanFolder(directory)
    color = folder.subfolder("color")
    if color is None or folder.subfolder("pose") is None or not _images(folder, color):
        return False
    return folder.subfolder("depth") is not None or bool(_numbered(folder, *_POSES))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder as ScanNet's exporter leaves it.

    Colour and depth have a camera each, in `intrinsic/intrinsic_color.txt` and `intrinsic_depth.txt`, or in the scene's
    own text file; the depth is registered to the colour image, both cameras in one place, as the exporter's extrinsics
    say. Without any depth images the frames have none. Poses are `scan_from_camera`; `-inf` stands for lost tracking.
    Raises `InvalidScanError` for images of another size than the intrinsics are for, and for missing files.
    """
    folder = ScanFolder(directory)
    color_folder = folder.subfolder("color")
    images = {} if color_folder is None else _images(folder, color_folder)
    if not images:
        raise InvalidScanError("The scan has no color/0.jpg and so on.")
    depths = _numbered(folder, *_DEPTHS)
    has_depth = bool(depths) or holds_depth(folder)
    source = ScanSource(
        camera=options.camera or _intrinsics(folder, "color"),
        depth_camera=_intrinsics(folder, "depth") if has_depth else None,
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=has_depth,
    )
    if options.camera is None:
        _check_size(next(iter(images.values())), source.camera)
    if has_depth and options.color_from_depth is None:
        _check_extrinsics(folder)
    discarded = Discarded()
    frames = _frames(folder, images, depths if has_depth else images, discarded)
    return assemble_scan(frames, discarded, source, options)


def _images(folder: ScanFolder, color: Path) -> dict[int, Path]:
    found = ((_NUMBERED.fullmatch(path.name), path) for path in folder.files_in(color))
    return dict(sorted((int(match.group(1)), path) for match, path in found if match))


def _frames(
    folder: ScanFolder, images: dict[int, Path], depths: dict[int, Path], discarded: Discarded
) -> list[Frame]:
    poses_of = _numbered(folder, *_POSES)
    complete = []
    for number, color in images.items():
        name, stem = folder.name_of(color), color.stem
        depth, pose = depths.get(number), poses_of.get(number)
        if depth is None:
            detail = f"depth/{stem}.png is missing; {folder.instead(f'depth/{stem}.png')}"
            discarded.add("no_depth", name, detail)
        elif pose is None:
            detail = f"pose/{stem}.txt is missing; {folder.instead(f'pose/{stem}.txt')}"
            discarded.add("no_pose", name, detail)
        elif folder.find(name, "the scan") is not None:
            complete.append((number, name, color, depth, pose))
    poses, _ = read_pose_files([row[4] for row in complete], [row[1] for row in complete], discarded)
    return [
        Frame(name, number / FRAME_RATE_HZ, color, depth, pose)
        for (number, name, color, depth, _), pose in zip(complete, poses, strict=True)
        if pose is not None
    ]


def _numbered(folder: ScanFolder, name: str, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Return the files of a folder by their numbers, whatever zeros stand before these."""
    found = folder.subfolder(name)
    paths = [] if found is None else folder.files_in(found)
    numbered = {int(path.stem): path for path in paths if path.stem.isdecimal() and path.suffix in suffixes}
    # Links must not lead out of the scan.
    return {n: path for n, path in numbered.items() if folder.find(folder.name_of(path), "the scan")}


def _intrinsics(folder: ScanFolder, kind: str) -> CameraHint:
    for name in (place.format(kind) for place in _INTRINSICS):
        K = _matrix(folder, name)
        if K is not None:
            return CameraHint(values=(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])))
    stated = _of_scene(folder, kind)
    if stated is None:
        raise InvalidScanError(
            f"{_INTRINSICS[0].format(kind)} is missing: it holds the camera, a matrix of 3x3 or 4x4."
        )
    return stated


def _of_scene(folder: ScanFolder, kind: str) -> CameraHint | None:
    """Return the camera of the text file that the data set has for each scene, None where there is none."""
    for path in folder.files_in(folder.path):
        if path.suffix.lower() != ".txt" or folder.find(path.name, "the scan") is None:
            continue
        lines = (line.partition("=") for line in read_text(path).splitlines())
        values = {key.strip(): value.strip() for key, sign, value in lines if sign}
        keys = [f"{key}_{kind}" for key in ("fx", "fy", "mx", "my")]
        if all(key in values for key in keys):
            return CameraHint(values=tuple(numbers([values[key] for key in keys], path.name)))
    return None


def _matrix(folder: ScanFolder, name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]] | None:
    path = folder.find(name, "the scan")
    if path is None:
        return None
    values = numbers([cell for row in rows(read_text(path)) for cell in row.cells()], name)
    side = {9: 3, 16: 4}.get(len(values))
    if side is None or not np.isfinite(values).all():
        raise InvalidScanError(f"{name} must hold a matrix of 3x3 or 4x4 numbers, not {len(values)} of them.")
    return np.array(values).reshape(side, side)


def _check_size(image: Path, camera: CameraHint) -> None:
    """Raise if the principal point is far from the middle of an image: it was resized after it was exported."""
    size = color_size(image)
    if size is None:
        return
    middle = camera.values[2:4]
    offset = max(abs(2 * middle[i] / size[i] - 1) for i in (0, 1))
    if offset > OPTIONS.max_principal_offset_ratio:
        raise InvalidScanError(
            f"{image.name} has {size[0]} x {size[1]} pixels, but intrinsic_color.txt is for about "
            f"{2 * middle[0]:.0f} x {2 * middle[1]:.0f}: the images were resized; give `camera` for them."
        )


def _check_extrinsics(folder: ScanFolder) -> None:
    """Raise for colour and depth cameras that are stated to be apart, which ScanNet's exporter never writes."""
    for name in ("intrinsic/extrinsic_color.txt", "intrinsic/extrinsic_depth.txt"):
        matrix = _matrix(folder, name)
        try:
            apart = matrix is not None and not np.allclose(
                Pose.from_matrix(matrix).matrix, np.eye(4), atol=1e-4
            )
        except InvalidPoseError:
            raise InvalidScanError(f"{name} must hold a 4x4 matrix with a rotation.") from None
        if apart:
            raise InvalidScanError(
                f"{name} says that colour and depth camera are apart: give depth_camera and color_from_depth."
            )
