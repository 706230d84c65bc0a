"""7-Scenes layout: `frame-000000.color.png`, `.depth.png`, `.pose.txt`, in one folder or in `seq-XX`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import REFERENCE_FOCAL_PX
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_share, relative_name
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.scan_files import read_camera_file, read_gravity, read_text, resolve_inside

# The data set states 585 px, with which its depth images were fused. Its colour images come from the same
# sensor's other camera, which structure from motion puts at the focal length of reference.
DEFAULT_INTRINSICS = (REFERENCE_FOCAL_PX, REFERENCE_FOCAL_PX, 320.0, 240.0)
DEFAULT_DEPTH_INTRINSICS = (585.0, 585.0, 320.0, 240.0)
DEFAULT_DEPTH_SCALE = 1000.0
FRAME_RATE_HZ = 30.0
# The files hold no times; sequences are laid one after the other, this far apart.
SEQUENCE_GAP_S = 1.0

_COLOR = re.compile(r"frame-(\d{1,9})\.color\.(?:png|jpg|jpeg)$")
_SEQUENCE = re.compile(r"seq-?\d+$")
# A pose of 16 numbers takes less than this.
_MAX_POSE_BYTES = 4096


@dataclass(frozen=True, slots=True)
class _Candidate:
    color: Path
    depth: Path
    pose: Path
    timestamp_s: float


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

    A frame without depth or pose, or with a pose that is no rigid transform, is discarded.
    Raises `InvalidScanError` for other files, mostly broken poses, or no usable frame.
    """
    candidates = list(_candidates(directory))
    if not candidates:
        raise InvalidScanError("The scan has no frame-000000.color.png at its top or in a folder seq-01.")
    camera_file = read_camera_file(directory)
    if options.camera is None and camera_file is None and options.depth_camera is None:
        options = replace(options, camera=DEFAULT_INTRINSICS, depth_camera=DEFAULT_DEPTH_INTRINSICS)
    source = ScanSource(
        camera=options.camera or (camera_file.camera if camera_file else DEFAULT_INTRINSICS),
        depth_scale=options.depth_scale
        or (camera_file.depth_scale if camera_file else None)
        or DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
    )
    discarded = Discarded()
    frames = _frames(directory, candidates, options.color_from_depth or Pose.identity(), discarded)
    return assemble_scan(frames, discarded, source, options)


def _sequences(directory: Path) -> list[Path]:
    inner = sorted(d for d in directory.iterdir() if _SEQUENCE.fullmatch(d.name) and d.is_dir())
    return [directory, *inner]


def _color_images(folder: Path) -> dict[int, Path]:
    """Return the colour images of one sequence by frame number, in order."""
    found = ((_COLOR.fullmatch(path.name), path) for path in folder.iterdir())
    return dict(sorted((int(match.group(1)), path) for match, path in found if match))


def _candidates(directory: Path) -> Iterator[_Candidate]:
    start_s = 0.0
    for folder in _sequences(directory):
        time_s = start_s
        for number, color in _color_images(folder).items():
            time_s = start_s + number / FRAME_RATE_HZ
            stem = color.name.split(".")[0]
            depth, pose = folder / f"{stem}.depth.png", folder / f"{stem}.pose.txt"
            for path in (color, depth, pose):
                resolve_inside(directory, relative_name(path, directory), "the scan")
            yield _Candidate(color, depth, pose, time_s)
        start_s = time_s + SEQUENCE_GAP_S if time_s > start_s else start_s


def _frames(
    directory: Path, candidates: list[_Candidate], color_from_depth: Pose, discarded: Discarded
) -> list[Frame]:
    depth_from_color = color_from_depth.inverse()
    frames, invalid = [], []
    for candidate in candidates:
        name = relative_name(candidate.color, directory)
        scan_from_depth = _read_pose(candidate.pose) if candidate.pose.is_file() else None
        if not candidate.depth.is_file():
            discarded.add("no_depth", name)
        elif not candidate.pose.is_file():
            discarded.add("no_pose", name)
        elif scan_from_depth is None:
            discarded.add("invalid_pose", name)
            invalid.append(name)
        else:
            scan_from_color = scan_from_depth @ depth_from_color
            frames.append(
                Frame(name, candidate.timestamp_s, candidate.color, candidate.depth, scan_from_color)
            )
    check_pose_share(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _read_pose(path: Path) -> Pose | None:
    """Return the pose of a file with a 4x4 matrix, None for anything else, such as NaN for lost tracking."""
    try:
        if path.stat().st_size > _MAX_POSE_BYTES:
            return None
        values = [float(cell) for cell in read_text(path).replace(",", " ").split()]
        return Pose.from_matrix(np.array(values).reshape(4, 4))
    except (OSError, ValueError, InvalidPoseError):
        return None
