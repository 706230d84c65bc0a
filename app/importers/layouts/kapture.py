"""kapture: `sensors/sensors.txt`, `records_camera.txt`, `trajectories.txt`, and pictures in `sensors/records_data`.

Source of the layout: kapture_format.adoc of github.com/naver/kapture. Poses are `sensor_from_world` with quaternions
w x y z, of a sensor or of a rig; depth images are 32-bit floats in metres without a header, or files of known kinds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.errors import InvalidPoseError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.se3 import Pose
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frame_files.colmap_cameras import MODELS, camera_of_colmap
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.rows.times import in_seconds
from app.importers.scan_files import numbers, read_gravity, read_text, rows, whole_numbers
from app.importers.unpacked import FrameFiles

SENSORS = "sensors/sensors.txt"
TRAJECTORIES = "sensors/trajectories.txt"
RIGS = "sensors/rigs.txt"
CAMERA_RECORDS = "sensors/records_camera.txt"
DEPTH_RECORDS = "sensors/records_depth.txt"
DATA = "sensors/records_data"
RAW_DEPTH_SUFFIX = ".depth"
DEFAULT_DEPTH_SCALE = 1000.0


@dataclass(frozen=True, slots=True)
class _Data:
    """Cameras by sensor; poses `world_from_device` by time and device; the rig and the place on it of each sensor;
    files by time and sensor."""

    cameras: dict[str, Camera]
    poses: dict[tuple[str, str], Pose | None]
    rigs: dict[str, tuple[str, Pose]]
    pictures: dict[tuple[str, str], str]
    depths: dict[tuple[str, str], str]


def detect(directory: Path) -> bool:
    """Return whether the folder holds the table of sensors and the trajectories."""
    return (directory / SENSORS).is_file() and (directory / CAMERA_RECORDS).is_file()


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of one camera; depth is that of the depth camera with a record of the same time, if there is one.

    Raises `InvalidScanError` for several cameras, and for files that are missing or not this.
    """
    folder, files, discarded = ScanFolder(directory), FrameFiles(options.scratch), Discarded()
    data = _read(folder)
    if not _has_depth(folder, data):
        data = replace(data, depths={})
    sensors = sorted({sensor for _, sensor in data.pictures})
    if len(sensors) != 1:
        raise InvalidScanError(f"The scan has pictures of {len(sensors)} cameras: send those of one.")
    camera = data.cameras.get(sensors[0])
    if camera is None and options.camera is None:
        raise InvalidScanError(
            f"{SENSORS} has no camera {sensors[0]!r} of a model that is known: give `camera` in the options."
        )
    depth_sensors = sorted({sensor for _, sensor in data.depths})
    if len(depth_sensors) > 1:
        raise InvalidScanError(f"The scan has depth of {len(depth_sensors)} sensors: send that of one.")
    frames = _frames(folder, data, files, discarded)
    depth_camera = data.cameras.get(depth_sensors[0]) if depth_sensors else None
    if depth_camera is not None and options.color_from_depth is None:
        options = _with_place_of_depth(options, data, sensors[0], depth_sensors[0], depth_camera)
    source = ScanSource(
        camera=options.camera or CameraHint(camera=camera),
        depth_camera=hint_of(depth_camera) if depth_camera and depth_camera != camera else None,
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        gravity=read_gravity(directory),
        has_depth=bool(data.depths),
        keeps=files,
    )
    return assemble_scan(frames, discarded, source, options)


def _has_depth(folder: ScanFolder, data: _Data) -> bool:
    """Whether the table of depth lists files, and any of them or other depth is there."""
    listed = (folder.find(f"{DATA}/{name}", DEPTH_RECORDS) for name in data.depths.values())
    colors = (folder.find(f"{DATA}/{name}", CAMERA_RECORDS) for name in data.pictures.values())
    return bool(data.depths) and (any(listed) or holds_depth(folder, colors))


def _with_place_of_depth(
    options: ScanOptions, data: _Data, color: str, depth: str, camera: Camera
) -> ScanOptions:
    """Return the options with the place of the depth camera beside the colour camera, where both are on one rig."""
    if color not in data.rigs or depth not in data.rigs or data.rigs[color][0] != data.rigs[depth][0]:
        return options
    color_from_depth = data.rigs[color][1].inverse() @ data.rigs[depth][1]
    if np.allclose(color_from_depth.matrix, np.eye(4), atol=1e-4):
        return options
    given = options.depth_camera or hint_of(camera)
    return replace(options, depth_camera=given, color_from_depth=color_from_depth)


def _frames(folder: ScanFolder, data: _Data, files: FrameFiles, discarded: Discarded) -> list[Frame]:
    keys = sorted(data.pictures, key=lambda key: float(key[0]))
    times_s = in_seconds(np.array([float(time) for time, _ in keys])).times_s
    depth_of = {time: (sensor, name) for (time, sensor), name in data.depths.items()}
    frames, invalid = [], []
    for key, time_s in zip(keys, times_s.tolist(), strict=True):
        name = f"{DATA}/{data.pictures[key]}"
        color, pose = folder.find(name, CAMERA_RECORDS), _pose_of(data, *key)
        depth = None
        if key[0] in depth_of:
            depth = _depth(folder, *depth_of[key[0]], data, files)
        if color is None:
            discarded.add("missing_file", name, f"{name}; {folder.instead(name)}")
        elif data.depths and depth is None:
            discarded.add("no_depth", name, f"{DEPTH_RECORDS} has no file at the time {key[0]}")
        elif isinstance(pose, str):
            discarded.add(pose, name)
            invalid += [name] if pose == "invalid_pose" else []
        else:
            frames.append(Frame(name, time_s, color, depth or color, pose))
    check_pose_ratio(len(invalid), len(frames) + len(invalid), f"that of {invalid[0]}" if invalid else "")
    return frames


def _pose_of(data: _Data, time: str, sensor: str) -> Pose | str:
    if (time, sensor) in data.poses:
        return data.poses[time, sensor] or "invalid_pose"
    rig, rig_from_sensor = data.rigs.get(sensor, ("", Pose.identity()))
    if (time, rig) not in data.poses:
        return "no_pose"
    pose = data.poses[time, rig]
    return "invalid_pose" if pose is None else pose @ rig_from_sensor


def _depth(folder: ScanFolder, sensor: str, name: str, data: _Data, files: FrameFiles) -> Path | None:
    path = folder.find(f"{DATA}/{name}", DEPTH_RECORDS)
    if path is None or path.suffix.lower() != RAW_DEPTH_SUFFIX:
        return path
    camera = data.cameras.get(sensor)
    values = np.frombuffer(path.read_bytes()[: 4 * (path.stat().st_size // 4)], "<f4")
    if camera is None or len(values) != camera.width * camera.height:
        raise InvalidScanError(
            f"{name} has {len(values)} values, which is not the size of its sensor {sensor!r}."
        )
    return files.write_depth_m(f"depth/{name}.png", values.reshape(camera.height, camera.width))


def _read(folder: ScanFolder) -> _Data:
    return _Data(
        cameras=_cameras(_table(folder, SENSORS, 3)),
        poses=_poses(_table(folder, TRAJECTORIES, 9)),
        rigs=_rigs(_table(folder, RIGS, 9)) if (folder.path / RIGS).is_file() else {},
        pictures=_records(folder, CAMERA_RECORDS),
        depths=_records(folder, DEPTH_RECORDS) if (folder.path / DEPTH_RECORDS).is_file() else {},
    )


def _records(folder: ScanFolder, name: str) -> dict[tuple[str, str], str]:
    """Return the files of a table by their time, a number as it is written, and their sensor."""
    table = _table(folder, name, 3)
    for time, *_ in table:
        if not np.isfinite(numbers([time], name)).all():
            raise InvalidScanError(f"{name}: the timestamp {time[:40]!r} must be a number.")
    return {(cells[0], cells[1]): cells[2] for cells in table}


def _table(folder: ScanFolder, name: str, columns: int) -> list[list[str]]:
    path = folder.find(name, "the scan")
    if path is None:
        raise InvalidScanError(f"{name} is missing; {folder.instead(name)}.")
    table = []
    for row in rows(read_text(path)):
        cells = [cell.strip() for cell in row.text.split(",")]
        if len(cells) < columns:
            raise InvalidScanError(
                f"{name} line {row.line}: expected {columns} columns and found {len(cells)}."
            )
        table.append(cells)
    return table


def _cameras(table: list[list[str]]) -> dict[str, Camera]:
    cameras = {}
    for sensor, _, kind, *cells in table:
        if kind not in ("camera", "depth") or not cells or cells[0] not in dict(MODELS):
            continue
        where = f"{SENSORS}: {sensor}"
        if len(cells) < 3:
            raise InvalidScanError(f"{where}: expected MODEL, WIDTH, HEIGHT, PARAMS.")
        width, height = whole_numbers(cells[1:3], where)
        cameras[sensor] = camera_of_colmap(cells[0], width, height, numbers(cells[3:], where), where)
    return cameras


def _poses(table: list[list[str]]) -> dict[tuple[str, str], Pose | None]:
    return {(time, device): _inverse(cells, TRAJECTORIES) for time, device, *cells in table}


def _rigs(table: list[list[str]]) -> dict[str, tuple[str, Pose]]:
    found = {sensor: (rig, _inverse(cells, RIGS)) for rig, sensor, *cells in table}
    return {sensor: (rig, pose) for sensor, (rig, pose) in found.items() if pose is not None}


def _inverse(cells: list[str], name: str) -> Pose | None:
    """Return the inverse of a pose written as qw qx qy qz tx ty tz, None for numbers that are none."""
    qw, qx, qy, qz, *translation = numbers(cells[:7], name)
    try:
        return Pose.from_quaternion(translation, [qx, qy, qz, qw]).inverse()
    except InvalidPoseError:
        return None
