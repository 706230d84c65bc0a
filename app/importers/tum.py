"""TUM RGB-D layout: `rgb.txt`, `depth.txt` and `groundtruth.txt`, each with its own timestamps."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.geometry.uniform_motion import UniformMotion
from app.importers.assembly import Discarded, ScanSource, assemble_scan, check_pose_ratio
from app.importers.association import Trajectory, associate
from app.importers.depth_presence import holds_depth
from app.importers.folder import ScanFolder
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.layouts import icl_nuim
from app.importers.rows.image_rows import ImageRows, parse_associations, parse_image_list
from app.importers.rows.times import UNITS_PER_S, Times, check_distinct, range_in_words
from app.importers.rows.trajectory_rows import TrajectoryRows, parse_trajectory
from app.importers.scan_files import optional_file, read_camera_file, read_gravity, read_text
from app.limits import limit

DEFAULT_DEPTH_SCALE = 5000.0
TRUTH = "groundtruth.txt"
ASSOCIATIONS = (
    "associations.txt", "association.txt", "associate.txt", "associated.txt", "assoc.txt", "rgb_depth.txt",
)  # fmt: skip
# What holds no trajectory, whatever its numbers are.
NO_TRAJECTORIES = frozenset({"rgb.txt", "depth.txt", "camera.txt", "gravity.txt", TRUTH, *ASSOCIATIONS})
TRAJECTORY_SUFFIXES = frozenset({".txt", ".csv", ".tum", ".traj", ".log", ".freiburg"})
# ORB-SLAM writes the poses of all frames, and those of its keyframes beside them.
ALL_FRAMES = "cameratrajectory.txt"
KEYFRAMES = "keyframetrajectory.txt"

WITHOUT_POSES = (
    '; add it, or give "poses": "estimate" to have them estimated from the pictures, or, for a walk straight on at an '
    "even speed, give start, speed_m_s, direction_deg and fps"
)
# What the TUM RGB-D benchmark publishes for the colour images of its three sensors (640 x 480).
PUBLISHED_INTRINSICS = {
    "1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "3": (535.4, 539.2, 320.1, 247.6),
}
_SENSOR = re.compile(r"^\s*#\s*file:.*freiburg([123])", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitOptions:
    """When times of two lists that don't meet are taken to be in different units."""

    max_matched_ratio: float = limit(
        0.2,
        "Another unit is tried where a smaller ratio of the images has a partner.",
        chosen="By hand: times from zero in another unit meet once, at zero.",
    )
    min_matched_ratio: float = limit(
        0.5,
        "Another unit is believed where at least this ratio of the images has a partner by it.",
        chosen="By hand: by chance hardly any image has one.",
    )


UNITS = UnitOptions()


@dataclass(frozen=True, slots=True)
class _ImageList:
    """Times (n,) in seconds and the images' files, None for one that isn't there; `rows` are what the list names."""

    times_s: Times
    paths: tuple[Path | None, ...]
    rows: ImageRows


@dataclass(frozen=True, slots=True)
class _Poses:
    """A trajectory, the file it is from, its text, and sentences on how it was read."""

    trajectory: Trajectory
    name: str
    text: str
    notes: tuple[str, ...]


def detect(directory: Path) -> bool:
    """Return whether the folder holds the lists of a TUM scan."""
    return any(optional_file(directory, name) is not None for name in ("rgb.txt", *ASSOCIATIONS))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a folder in TUM layout.

    A colour image is paired with the nearest depth image and with the trajectory at its own time (see
    `association`), both within `max_time_difference_s`; without either it is discarded. One list of both images
    (`associations.txt`) may take the place of `rgb.txt` and `depth.txt`, and the only other trajectory that of
    `groundtruth.txt`. The camera is that of the options, else of `camera.txt`, else the published one of the sensor
    that `groundtruth.txt` names in its `# file:` comment; the depth scale that of the options, else of `camera.txt`,
    else 5000 per metre. A scan with none of its depth images has no depth. Without a trajectory the poses are those
    of the options' uniform motion, frame by frame.
    Raises `InvalidScanError` for missing or malformed lists, unknown intrinsics, or no usable frame.
    """
    folder, discarded = ScanFolder(directory), Discarded()
    color_rows, listed_depth = _image_rows(folder)
    color = _found(folder, color_rows)
    there = _depth_rows_there(folder, color, listed_depth)
    # Without depth images the pictures stand for them.
    depth_rows = color_rows if there is None else there
    tolerance_s = options.max_time_difference_s
    poses = _poses(directory, color_rows, depth_rows, options)
    depth_rows = _in_unit_of(color_rows, depth_rows, tolerance_s, "the depth images")
    camera_file = read_camera_file(directory)
    notes = dict.fromkeys([*color_rows.notes, *depth_rows.notes, *poses.notes])
    source = ScanSource(
        camera=options.camera or (camera_file.camera if camera_file else _published_camera(poses)),
        depth_scale=camera_file.depth_scale if camera_file else None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        # A stated walk stands upright in its own frame.
        gravity=read_gravity(directory) if options.motion is None else (0.0, 0.0, -1.0),
        notes=tuple(notes),
        has_depth=there is not None,
    )
    color = _existing(color, folder, discarded)
    depth = color if there is None else _found(folder, depth_rows)
    poses = _moved(poses, options.convention.time_offset_s)
    frames = _frames(folder, color, depth, poses, discarded, tolerance_s)
    scan = assemble_scan(frames, discarded, source, options)
    if icl_nuim.is_trajectory(poses.name):
        return icl_nuim.with_right_hand(scan, options.convention)
    return replace(scan, trajectory=poses.trajectory)


def _depth_rows_there(folder: ScanFolder, color: _ImageList, depth: ImageRows | None) -> ImageRows | None:
    """Return the rows of depth, None where no image of them is there, nor any other that may be of depth."""
    if depth is None:
        return None
    is_there = any(folder.find(name, place) for name, place in zip(depth.names, depth.places, strict=True))
    return depth if is_there or holds_depth(folder, color.paths) else None


def _image_rows(folder: ScanFolder) -> tuple[ImageRows, ImageRows | None]:
    """Return the rows of colour and depth, from their own lists or from one association file; None for depth without a
    list where there are no images that one may be missing for."""
    directory = folder.path
    path = optional_file(directory, "rgb.txt")
    candidates = [path] if path else [optional_file(directory, name) for name in ASSOCIATIONS]
    for candidate in filter(None, candidates):
        both = parse_associations(read_text(candidate), candidate.name)
        if both is not None:
            return both
        if path is None:
            raise InvalidScanError(
                f"{candidate.name} must have rows `timestamp colour-file timestamp depth-file`; give rgb.txt and "
                "depth.txt for anything else."
            )
    color = parse_image_list(_list_text(directory, "rgb.txt", "colour images"), "rgb.txt", "colour")
    if optional_file(directory, "depth.txt") is None and not holds_depth(folder):
        return color, None
    depth = parse_image_list(_list_text(directory, "depth.txt", "depth images"), "depth.txt", "depth")
    return color, depth


def _list_text(directory: Path, name: str, content: str) -> str:
    path = optional_file(directory, name)
    if path is None:
        raise InvalidScanError(f"The scan has no {content}: {name} is missing.")
    return read_text(path)


def _poses(directory: Path, color: ImageRows, depth: ImageRows, options: ScanOptions) -> _Poses:
    """Return the trajectory of the scan, or that of the stated walk."""
    if options.estimate_poses:
        check_distinct({_file_of(color): color.times_s, _file_of(depth): depth.times_s})
        return _Poses(Trajectory.still(color.times_s), "no trajectory", "", ())
    truth = optional_file(directory, TRUTH)
    if options.motion is not None:
        if truth is not None:
            raise InvalidScanError(
                "The scan has camera poses of its own in groundtruth.txt: leave out start, speed_m_s, direction_deg "
                "and fps, or take the file out of the scan."
            )
        check_distinct({_file_of(color): color.times_s, _file_of(depth): depth.times_s})
        return _Poses(_walk(color.times_s, options.motion), "the stated motion", "", ())
    notes: tuple[str, ...] = ()
    if truth is None:
        truth = _other_trajectory(directory, color)
        notes = (
            f"The poses were read from {truth.name}, the only trajectory, as there is no groundtruth.txt.",
        )
    text = read_text(truth)
    rows = _with_image_times(parse_trajectory(text, truth.name), truth.name, color)
    lists = {_file_of(color): color.times_s, _file_of(depth): depth.times_s, truth.name: rows.times_s}
    check_distinct(lists)
    times_s, note = _matching_unit(color.times_s, rows.times_s, options.max_time_difference_s, truth.name)
    trajectory = Trajectory.from_rows(np.column_stack([times_s, rows.values[:, 1:]]))
    invalid = np.flatnonzero(~trajectory.valid)
    example = f"the one at {trajectory.times_s[invalid[0]]:.6f} s" if len(invalid) else ""
    check_pose_ratio(len(invalid), len(trajectory.valid), example)
    return _Poses(trajectory, truth.name, text, (*notes, *rows.notes, *note))


def _moved(poses: _Poses, offset_s: float) -> _Poses:
    """Return the trajectory in which the pose of a picture is found at its own time plus an offset."""
    if offset_s == 0:
        return poses
    return replace(poses, trajectory=poses.trajectory.moved(offset_s))


def _file_of(rows: ImageRows) -> str:
    return rows.places[0].rpartition(" line ")[0]


def _walk(times_s: Times, motion: UniformMotion) -> Trajectory:
    poses = [motion.pose(n) for n in range(len(times_s))]
    rows = [
        [time_s, *p.translation, *p.quaternion] for time_s, p in zip(np.sort(times_s), poses, strict=True)
    ]
    return Trajectory.from_rows(np.array(rows))


def _other_trajectory(directory: Path, color: ImageRows) -> Path:
    """Return the only file that holds a trajectory; raises `InvalidScanError` that names those there are."""
    files = sorted(path for path in directory.iterdir() if path.suffix.lower() in TRAJECTORY_SUFFIXES)
    found = [path for path in files if path.name.lower() not in NO_TRAJECTORIES and _holds_poses(path, color)]
    if any(path.name.lower() == ALL_FRAMES for path in found):
        found = [path for path in found if path.name.lower() != KEYFRAMES]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InvalidScanError(f"The scan has no camera poses: {TRUTH} is missing{WITHOUT_POSES}.")
    names = " and ".join(filter(None, [", ".join(path.name for path in found[:-1]), found[-1].name]))
    raise InvalidScanError(
        f"The scan has no camera poses: {TRUTH} is missing. {names} hold trajectories: send only the one to use."
    )


def _holds_poses(path: Path, color: ImageRows) -> bool:
    # A link may lead anywhere; what is listed by name is followed within the folder alone.
    if path.is_symlink() or not path.is_file():
        return False
    try:
        rows = parse_trajectory(read_text(path), path.name)
    except InvalidScanError:
        return False
    return bool(np.isfinite(rows.times_s).all()) or len(rows.values) == len(color.names)


def _with_image_times(rows: TrajectoryRows, name: str, color: ImageRows) -> TrajectoryRows:
    """Return rows without times as one for each colour image, in the order of time."""
    if np.isfinite(rows.times_s).all():
        return rows
    if len(rows.values) != len(color.names):
        raise InvalidScanError(
            f"{name} has {len(rows.values)} rows of a matrix without a time for {len(color.names)} colour images: put "
            "the time in front of each, or give one row for each image."
        )
    values = np.column_stack([np.sort(color.times_s), rows.values[:, 1:]])
    note = f"The rows of {name} hold no times; they were given to the colour images in their order."
    return replace(rows, values=values, notes=(*rows.notes, note))


def _in_unit_of(color: ImageRows, depth: ImageRows, tolerance_s: float, what: str) -> ImageRows:
    times_s, note = _matching_unit(color.times_s, depth.times_s, tolerance_s, what)
    return replace(depth, times_s=times_s, notes=(*depth.notes, *note))


def _matching_unit(
    times_s: Times, others: Times, tolerance_s: float, name: str
) -> tuple[Times, tuple[str, ...]]:
    """Return the other times in seconds: as they are, or in the smaller unit in which they meet the first ones."""
    if _matched_ratio(times_s, others, tolerance_s) >= UNITS.max_matched_ratio:
        return others, ()
    for unit, per_s in UNITS_PER_S.items():
        if _matched_ratio(times_s, others / per_s, tolerance_s) >= UNITS.min_matched_ratio:
            return others / per_s, (f"The times of {name} were read as {unit}.",)
    return others, ()


def _matched_ratio(times_s: Times, others_s: Times, tolerance_s: float) -> float:
    ordered = np.sort(others_s)
    right = np.searchsorted(ordered, times_s).clip(0, len(ordered) - 1)
    left = (right - 1).clip(0)
    near = np.minimum(np.abs(ordered[right] - times_s), np.abs(ordered[left] - times_s))
    return float((near <= tolerance_s).mean())


def _published_camera(poses: _Poses) -> CameraHint:
    if icl_nuim.is_trajectory(poses.name):
        return hint_of(icl_nuim.CAMERA)
    sensor = _SENSOR.search(poses.text)
    if sensor is None:
        raise InvalidScanError(
            "The scan's camera is not known: give `camera` in the options, or add camera.txt with one row "
            "`PINHOLE width height fx fy cx cy`."
        )
    return hint_of(Camera.from_values(PUBLISHED_INTRINSICS[sensor.group(1)], 640, 480))


def _found(folder: ScanFolder, rows: ImageRows) -> _ImageList:
    paths = tuple(folder.find(name, place) for name, place in zip(rows.names, rows.places, strict=True))
    return _ImageList(rows.times_s, paths, rows)


def _missing(folder: ScanFolder, rows: ImageRows, i: int) -> str:
    return f"{rows.names[i]} of {rows.places[i]}; {folder.instead(rows.names[i])}"


def _existing(color: _ImageList, folder: ScanFolder, discarded: Discarded) -> _ImageList:
    """Return the list without the images that are not there, so that they take no depth image from others."""
    there = np.array([path is not None for path in color.paths])
    for i in np.flatnonzero(~there).tolist():
        detail = "" if "missing_file" in discarded.details else _missing(folder, color.rows, i)
        discarded.add("missing_file", color.rows.names[i].replace("\\", "/"), detail)
    paths = tuple(path for path in color.paths if path is not None)
    return _ImageList(color.times_s[there], paths, color.rows)


def _frames(
    folder: ScanFolder,
    color: _ImageList,
    depth: _ImageList,
    poses: _Poses,
    discarded: Discarded,
    tolerance_s: float,
) -> list[Frame]:
    partners = associate(color.times_s, depth.times_s, tolerance_s)
    ranges = {
        "no_depth": (_file_of(depth.rows), depth.times_s),
        "no_pose": (poses.name, poses.trajectory.times_s),
    }
    frames = []
    for time_s, path, partner in zip(color.times_s.tolist(), color.paths, partners.tolist(), strict=True):
        if path is None:
            continue
        name = folder.name_of(path)
        pose = poses.trajectory.pose_at(time_s, tolerance_s)
        depth_path = depth.paths[partner]
        reason = "no_depth" if partner < 0 else pose if isinstance(pose, str) else ""
        if reason in ranges:
            # Once: finding the ranges goes through whole lists.
            detail = "" if reason in discarded.details else _ranges(color, *ranges[reason])
            discarded.add(reason, name, detail)
        elif depth_path is None:
            detail = "" if "missing_file" in discarded.details else _missing(folder, depth.rows, partner)
            discarded.add("missing_file", name, detail)
        elif isinstance(pose, str):
            discarded.add(pose, name)
        else:
            frames.append(Frame(name, time_s, path, depth_path, pose))
    return frames


def _ranges(color: _ImageList, other: str, other_s: Times) -> str:
    return f"{range_in_words(_file_of(color.rows), color.times_s)}, {range_in_words(other, other_s)}"
