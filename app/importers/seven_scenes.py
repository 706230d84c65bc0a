"""7-Scenes layout: `frame-000000.color.png`, `.depth.png`, `.pose.txt`, in one folder or in `seq-XX`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from app.errors import InvalidScanError
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.pose_files import read_pose_files
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.scan_files import (
    optional_file,
    read_camera_file,
    read_gravity,
    read_text,
    resolve_inside,
    rows,
)

# The data set states 585 px, with which its depth images were fused. Its colour images come from the same
# sensor's other camera, which structure from motion puts at the focal length of reference.
DEFAULT_CAMERA = CameraHint(values=(REFERENCE_FOCAL_PX, REFERENCE_FOCAL_PX, 320.0, 240.0))
DEFAULT_DEPTH_CAMERA = CameraHint(values=(585.0, 585.0, 320.0, 240.0))
DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 30.0
# The files hold no times; sequences are laid one after the other, this far apart.
SEQUENCE_GAP_S = 1.0

_COLOR = re.compile(r"frame-(\d{1,9})\.color\.(?:png|jpe?g|webp|heic|avif|tiff?)$", re.IGNORECASE)
_DEPTH_SUFFIXES = (".png", ".tiff", ".tif", ".pgm", ".exr", ".npy")
_SEQUENCE = re.compile(r"seq-?\d+$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Candidate:
    color: Path
    depth: Path | None
    pose: Path | None
    timestamp_s: float


@dataclass(frozen=True, slots=True)
class NamedFrames:
    """Frames that are named as in 7-Scenes, how their poses were read, and whether the scan has depth images; without
    them a frame's picture stands for its depth."""

    frames: list[Frame]
    notes: tuple[str, ...]
    has_depth: bool


def detect(directory: Path) -> bool:
    """Return whether the folder, or a `seq-XX` folder in it, holds 7-Scenes colour images."""
    return any(_color_images(folder) for folder in _sequences(directory))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in 7-Scenes layout, all of its sequences in one.

    Times are frame numbers at 30 Hz; the depth scale is 1000 per metre unless stated. The camera is that of
    the options, else of `camera.txt`. With neither the scan is taken for an original one, **whose depth is not
    registered to its colour images**: colour at its own focal length, depth at 585 px, registered on the way,
    both cameras in one place, for how far they are apart is not published; give `depth_camera` and
    `color_from_depth` if you know it. The poses of the
    original are those of the depth camera, so they are moved to the colour camera.

    Poses are 4x4 matrices or their upper 3x4, by rows or, if that makes more of them rotations, by columns. A frame
    without depth or pose, or with a pose that is no rigid transform, is discarded. Without any depth images the frames
    have none.
    Raises `InvalidScanError` for other files, mostly broken poses, or no usable frame.
    """
    folder = ScanFolder(directory)
    if not detect(directory):
        raise InvalidScanError("The scan has no frame-000000.color.png at its top or in a folder seq-01.")
    camera_file = read_camera_file(directory)
    if options.camera is None and camera_file is None and options.depth_camera is None:
        options = replace(options, camera=DEFAULT_CAMERA, depth_camera=DEFAULT_DEPTH_CAMERA)
    source = ScanSource(
        camera=options.camera or (camera_file.camera if camera_file else DEFAULT_CAMERA),
        depth_scale=camera_file.depth_scale if camera_file else None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
    )
    discarded = Discarded()
    found = frames_in(folder, options, discarded)
    source = replace(source, notes=found.notes, has_depth=found.has_depth)
    return assemble_scan(found.frames, discarded, source, options)


def frames_in(folder: ScanFolder, options: ScanOptions, discarded: Discarded) -> NamedFrames:
    """Return the frames of a folder with names as in 7-Scenes that have all of their files."""
    candidates = list(_candidates(folder))
    has_depth = any(candidate.depth for candidate in candidates) or holds_depth(folder)
    if not has_depth:
        candidates = [replace(candidate, depth=candidate.color) for candidate in candidates]
    color_from_depth = options.color_from_depth or Pose.identity()
    return NamedFrames(*_frames(folder, candidates, color_from_depth, discarded), has_depth)


def sequences_of_split(directory: Path, split: str) -> tuple[str, ...]:
    """Return the folders of the sequences of the data set's `TrainSplit.txt` or `TestSplit.txt`, such as `seq-01`.

    `split` is `train` or `test`. Raises `InvalidScanError` where the file is missing or names another sequence than
    there are.
    """
    name = f"{split.capitalize()}Split.txt"
    path = optional_file(directory, name)
    if path is None:
        raise InvalidScanError(f"{name} is missing: give frames as start:stop:step instead.")
    numbers_of = {int(re.sub(r"\D", "", folder.name)): folder.name for folder in _sequences(directory)[1:]}
    folders = []
    for row in rows(read_text(path)):
        match = re.search(r"(\d+)$", row.text)
        if match is None or int(match.group(1)) not in numbers_of:
            raise InvalidScanError(f"{name} line {row.line}: the scan has no sequence {row.text[:40]!r}.")
        folders.append(numbers_of[int(match.group(1))])
    return tuple(folders)


def _sequences(directory: Path) -> list[Path]:
    inner = sorted(d for d in directory.iterdir() if _SEQUENCE.fullmatch(d.name) and d.is_dir())
    return [directory, *inner]


def _color_images(folder: Path) -> dict[int, Path]:
    """Return the colour images of one sequence by frame number, in order."""
    found = ((_COLOR.fullmatch(path.name), path) for path in folder.iterdir())
    return dict(sorted((int(match.group(1)), path) for match, path in found if match))


def _candidates(folder: ScanFolder) -> Iterator[_Candidate]:
    start_s = 0.0
    for sequence in _sequences(folder.path):
        time_s = start_s
        for number, color in _color_images(sequence).items():
            time_s = start_s + number / FRAME_RATE_HZ
            resolve_inside(folder.path, folder.name_of(color), "the scan")
            stem = folder.name_of(sequence / color.name.split(".")[0])
            depth = (folder.find(f"{stem}.depth{suffix}", "the scan") for suffix in _DEPTH_SUFFIXES)
            pose = folder.find(f"{stem}.pose.txt", "the scan")
            yield _Candidate(color, next((path for path in depth if path is not None), None), pose, time_s)
        start_s = time_s + SEQUENCE_GAP_S if time_s > start_s else start_s


def _frames(
    folder: ScanFolder, candidates: list[_Candidate], color_from_depth: Pose, discarded: Discarded
) -> tuple[list[Frame], tuple[str, ...]]:
    """Return the frames that have all of their files, and how the poses were read."""
    complete = []
    for candidate in candidates:
        name = folder.name_of(candidate.color)
        stem = name.rpartition(".color.")[0]
        if candidate.depth is None:
            discarded.add("no_depth", name, _missing(folder, f"{stem}.depth.png"))
        elif candidate.pose is None:
            discarded.add("no_pose", name, _missing(folder, f"{stem}.pose.txt"))
        else:
            complete.append((candidate, candidate.depth, candidate.pose))
    names = [folder.name_of(candidate.color) for candidate, _, _ in complete]
    poses, notes = read_pose_files([pose for _, _, pose in complete], names, discarded)
    depth_from_color = color_from_depth.inverse()
    return [
        Frame(name, candidate.timestamp_s, candidate.color, depth, scan_from_depth @ depth_from_color)
        for (candidate, depth, _), name, scan_from_depth in zip(complete, names, poses, strict=True)
        if scan_from_depth is not None
    ], notes


def _missing(folder: ScanFolder, name: str) -> str:
    return f"{name} is missing; {folder.instead(name)}"
