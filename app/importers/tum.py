"""TUM RGB-D layout: `rgb.txt`, `depth.txt` and `groundtruth.txt`, each with its own timestamps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.uniform_motion import UniformMotion
from app.importers.assembly import (
    Discarded,
    Intrinsics,
    ScanSource,
    assemble_scan,
    check_pose_share,
    relative_name,
)
from app.importers.association import Trajectory, associate
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.scan_files import (
    numbers,
    optional_file,
    read_camera_file,
    read_gravity,
    read_text,
    resolve_inside,
    rows,
)

DEFAULT_DEPTH_SCALE = 5000.0

WITHOUT_POSES = (
    "; add it or, for a walk straight on at an even speed, give start, speed_m_s, direction_deg and fps"
)
# What the TUM RGB-D benchmark publishes for the colour images of its three sensors (640 x 480).
PUBLISHED_INTRINSICS = {
    "1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "3": (535.4, 539.2, 320.1, 247.6),
}
_SENSOR = re.compile(r"^\s*#\s*file:.*freiburg([123])", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class _ImageList:
    times_s: NDArray[np.float64]
    paths: tuple[Path, ...]


def detect(directory: Path) -> bool:
    """Return whether the folder holds the lists of a TUM scan."""
    return (directory / "rgb.txt").is_file()


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in TUM layout.

    A colour image is paired with the nearest depth image and with the trajectory at its own time (see
    `association`), both within `max_time_difference_s`; without either it is discarded. The camera is that of
    the options, else of `camera.txt`, else the published one of the sensor that `groundtruth.txt` names in
    its `# file:` comment; the depth scale that of the options, else of `camera.txt`, else 5000 per metre.
    Without `groundtruth.txt` the poses are those of the options' uniform motion, frame by frame of `rgb.txt`.
    Raises `InvalidScanError` for missing or malformed lists, unknown intrinsics, or no usable frame.
    """
    color, depth = _image_list(directory, "rgb.txt", "colour"), _image_list(directory, "depth.txt", "depth")
    truth, trajectory = _poses(directory, color.times_s, options.motion)
    camera_file = read_camera_file(directory)
    source = ScanSource(
        camera=options.camera or (camera_file.camera if camera_file else _published_camera(truth)),
        depth_scale=options.depth_scale
        or (camera_file.depth_scale if camera_file else None)
        or DEFAULT_DEPTH_SCALE,
        # A stated walk stands upright in its own frame.
        gravity=read_gravity(directory) if options.motion is None else (0.0, 0.0, -1.0),
    )
    discarded = Discarded()
    frames = _frames(directory, _existing(color, directory, discarded), depth, trajectory, discarded, options)
    return assemble_scan(frames, discarded, source, options)


def _poses(
    directory: Path, times_s: NDArray[np.float64], motion: UniformMotion | None
) -> tuple[str, Trajectory]:
    """Return the text of `groundtruth.txt`, if there is one, and the poses: its own, or the stated walk's."""
    if motion is None:
        text = _list_text(directory, "groundtruth.txt", "camera poses", WITHOUT_POSES)
        return text, _trajectory(text)
    if optional_file(directory, "groundtruth.txt") is not None:
        raise InvalidScanError(
            "The scan has camera poses of its own in groundtruth.txt: leave out start, speed_m_s, direction_deg and "
            "fps, or take the file out of the scan."
        )
    poses = [motion.pose(n) for n in range(len(times_s))]
    rows_ = [
        [time_s, *p.translation, *p.quaternion] for time_s, p in zip(np.sort(times_s), poses, strict=True)
    ]
    return "", Trajectory.from_rows(np.array(rows_))


def _list_text(directory: Path, name: str, content: str, instead: str = "") -> str:
    path = optional_file(directory, name)
    if path is None:
        raise InvalidScanError(f"The scan has no {content}: {name} is missing{instead}.")
    return read_text(path)


def _image_list(directory: Path, name: str, content: str) -> _ImageList:
    times, paths = [], []
    for row in rows(_list_text(directory, name, f"{content} images")):
        where = f"{name} line {row.line}"
        cells = row.cells(max_cells=2)
        if len(cells) != 2:
            raise InvalidScanError(f"{where}: expected a timestamp and a file name.")
        times.append(_timestamp(cells[0], where))
        paths.append(resolve_inside(directory, cells[1], where))
    if not paths:
        raise InvalidScanError(f"{name} lists no {content} images.")
    return _ImageList(np.array(times), tuple(paths))


def _timestamp(cell: str, where: str) -> float:
    (time_s,) = numbers([cell], where)
    if not np.isfinite(time_s):
        raise InvalidScanError(f"{where}: the timestamp {cell!r} must be a number of seconds.")
    return time_s


def _trajectory(text: str) -> Trajectory:
    values = []
    for row in rows(text):
        where = f"groundtruth.txt line {row.line}"
        cells = row.cells()
        if len(cells) < 8:
            raise InvalidScanError(f"{where}: expected 8 columns, timestamp tx ty tz qx qy qz qw.")
        values.append([_timestamp(cells[0], where), *numbers(cells[1:8], where)])
    if not values:
        raise InvalidScanError("The scan has no camera poses: groundtruth.txt lists none.")
    trajectory = Trajectory.from_rows(np.array(values))
    invalid = np.flatnonzero(~trajectory.valid)
    example = f"the one at {trajectory.times_s[invalid[0]]:.6f} s" if len(invalid) else ""
    check_pose_share(len(invalid), len(trajectory.valid), example)
    return trajectory


def _published_camera(truth: str) -> Intrinsics:
    sensor = _SENSOR.search(truth)
    if sensor is None:
        raise InvalidScanError(
            "The scan's camera is not known: give `camera` in the options, or add camera.txt with one row "
            "`PINHOLE width height fx fy cx cy`."
        )
    return Camera.from_values(PUBLISHED_INTRINSICS[sensor.group(1)], 640, 480)


def _existing(color: _ImageList, directory: Path, discarded: Discarded) -> _ImageList:
    """Return the list without the images that are not there, so that they take no depth image from others."""
    there = np.array([path.is_file() for path in color.paths])
    for i in np.flatnonzero(~there):
        discarded.add("missing_file", relative_name(color.paths[i], directory))
    return _ImageList(color.times_s[there], tuple(p for p, ok in zip(color.paths, there, strict=True) if ok))


def _frames(
    directory: Path,
    color: _ImageList,
    depth: _ImageList,
    trajectory: Trajectory,
    discarded: Discarded,
    options: ScanOptions,
) -> list[Frame]:
    tolerance_s = options.max_time_difference_s
    partners = associate(color.times_s, depth.times_s, tolerance_s)
    frames = []
    for time_s, path, partner in zip(color.times_s.tolist(), color.paths, partners.tolist(), strict=True):
        name = relative_name(path, directory)
        pose = trajectory.pose_at(time_s, tolerance_s)
        if partner < 0:
            discarded.add("no_depth", name)
        elif not depth.paths[partner].is_file():
            discarded.add("missing_file", name)
        elif isinstance(pose, str):
            discarded.add(pose, name)
        else:
            frames.append(Frame(name, time_s, path, depth.paths[partner], pose))
    return frames
