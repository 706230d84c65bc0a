"""ROS 1 and ROS 2 bags (`.bag`, `.db3`, `.mcap`): colour, depth and camera of a RealSense, Kinect or Orbbec, and poses.

Read with the library `rosbags`; files of ROS 2 may be packed by zstd (`.db3.zstd`, `.mcap.zstd`). Messages follow the
definitions of sensor_msgs, nav_msgs, geometry_msgs and tf2_msgs (docs.ros.org). A topic of poses is that of a frame of
the robot; transforms lead from there to the colour camera.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera_hint import CameraHint
from app.importers.archives.zstd_files import PACKED_SUFFIXES, unpack_files
from app.importers.assembly import Discarded, ScanSource, assemble_scan
from app.importers.association import Trajectory, associate
from app.importers.frame_files.spacing import spaced_rows
from app.importers.frames import Frame, Scan, ScanOptions
from app.importers.recordings.files import recordings_in
from app.importers.recordings.ros_camera import camera_of
from app.importers.recordings.ros_images import depth_of, is_depth, picture_of
from app.importers.recordings.ros_transforms import Transforms, pose_of
from app.importers.unpacked import FrameFiles

SUFFIXES = (".bag", ".db3", ".mcap")
METADATA = "metadata.yaml"
DEFAULT_DEPTH_SCALE = 1000.0
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA = "sensor_msgs/msg/CameraInfo"
# The only kind of poses that names the frame that it is the pose of.
ODOMETRY = "nav_msgs/msg/Odometry"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    ODOMETRY,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# Words by which drivers name the images that are wanted, the best first.
COLOR_WORDS = ("color", "rgb", "image_raw", "image")
DEPTH_WORDS = ("aligned", "registered", "depth_to_rgb", "depth")
OTHER_WORDS = ("infra", "ir/", "/ir", "fisheye", "left", "right", "confidence", "mask")
POSE_WORDS = ("camera", "pose", "odom")
# Topics of poses that say where a robot is to go, or is told that it is.
TOLD_POSES = ("goal", "initialpose", "initial_pose", "setpoint")
# What the library raises for damaged files: it takes their numbers and keys as they are.
_DAMAGE = (
    AssertionError,
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    TypeError,
    ValueError,
)
# Characters that an error shows of the library's own, which may quote a whole file. By hand: two lines.
_MAX_REASON_CHARACTERS = 200
# What librealsense records by itself: no poses, and depth that is not aligned although all frames have one name.
_VIEWER = re.compile(r"/device_\d+/sensor_\d+/")
OF_VIEWER = (
    "This is a recording of the RealSense Viewer, which has no camera poses and depth that is not aligned to colour: "
    "play it to realsense2_camera with align_depth, and record its topics with those of a tracker as a new bag, or let "
    "RTAB-Map track it and send its .db."
)
# A recording that was split has parts with numbers behind their names.
_PART = re.compile(r"_\d+\.\w+(?:\.zstd?)?$")
# Poses are interpolated between rows that are no further apart: slow trackers send five a second, with jitter.
MAX_POSE_GAP_S = 0.25


@dataclass(slots=True)
class _Stream:
    """The messages of a topic: times (n,) in seconds, the images' files, and the frame that they are in."""

    times_s: list[float] = field(default_factory=list)
    paths: list[Path] = field(default_factory=list)
    frame: str = ""
    camera: CameraHint | None = None


@dataclass(slots=True)
class Topics:
    """The topics that are read; None where the bag has none of a kind."""

    color: str
    depth: str | None
    poses: str | None


def detect(directory: Path) -> bool:
    """Return whether the folder holds a bag."""
    return bool(recordings_in(directory, *SUFFIXES, *PACKED_SUFFIXES))


def open_scan(directory: Path, options: ScanOptions) -> Scan:
    """Return the scan of a bag; colour, depth and poses are paired by their times.

    Depth that is not registered to colour has its own camera, placed by the bag's transforms. Raises
    `InvalidScanError` for a bag that lacks colour or poses, names the topics that it has, and for a damaged one.
    """
    files, discarded = FrameFiles(options.scratch), Discarded()
    with _opened(directory, options.scratch) as reader:
        topics = chosen_topics(reader)
        color, depth, rows, transforms, frame = _read(reader, topics, files)
    camera = options.camera or color.camera
    if camera is None:
        raise InvalidScanError(f"The bag has no CameraInfo for {topics.color}: give `camera` in the options.")
    if options.estimate_poses:
        trajectory = Trajectory.still(np.array(color.times_s))
    else:
        trajectory = transforms.trajectory_of(color.frame, rows, frame, topics.poses)
    frames = _frames(color, depth, trajectory, options, discarded)
    registered = depth is None or depth.frame == color.frame
    if depth is not None and not registered and not (depth.camera or options.depth_camera):
        raise InvalidScanError(
            f"The bag's depth is in the frame {depth.frame}, colour in {color.frame}, and there is no CameraInfo for "
            f"{topics.depth}: record its camera_info and /tf_static too, or depth that is aligned to colour."
        )
    source = ScanSource(
        camera=camera,
        depth_camera=None if registered or depth is None else depth.camera,
        depth_scale=None,
        default_depth_scale=DEFAULT_DEPTH_SCALE,
        has_depth=depth is not None,
        keeps=files,
    )
    given = options
    if not registered and depth is not None and options.color_from_depth is None:
        given = transforms.with_place_of_depth(options, color.frame, depth.frame, depth.camera)
    return assemble_scan(frames, discarded, source, given)


@contextmanager
def _opened(directory: Path, scratch: Path | None) -> Iterator[Any]:
    """Open the bag in a folder with the library, whose errors become an `InvalidScanError`."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InvalidScanError("ROS bags need the extra: pip install 'roomfix[scans]'.") from None
    bags = recordings_in(directory, *SUFFIXES, *PACKED_SUFFIXES)
    has_metadata = (directory / METADATA).is_file()
    if not has_metadata and len(bags) > 1 and not all(_PART.search(path.name) for path in bags):
        names = ", ".join(path.name for path in bags[:3])
        raise InvalidScanError(f"The scan has {len(bags)} bags, {names}: send those of one recording only.")
    try:
        with (
            _plain(directory, bags, scratch) as paths,
            AnyReader(paths, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader,
        ):
            yield reader
    except (AnyReaderError, *_DAMAGE) as error:
        name, remedy = bags[0].name, ""
        if has_metadata and bags[0].suffix.lower() != ".bag":
            remedy = f": copy it again, or send it without {METADATA} if that is what is damaged"
            name = f"{name} with its {METADATA}"
        raise InvalidScanError(
            f"{name} can't be read as a ROS bag ({_reason(error, directory)}){remedy}."
        ) from None


def _reason(error: BaseException, directory: Path) -> str:
    """Return what the library says in one line, without the server's folder."""
    text = " ".join(str(error).replace(f"{directory}/", "").split()).rstrip(".")
    return text[:_MAX_REASON_CHARACTERS] or type(error).__name__


@contextmanager
def _plain(directory: Path, bags: list[Path], scratch: Path | None) -> Iterator[list[Path]]:
    """Yield what the library is to open; bags that are packed are unpacked for as long, each of their files by itself:
    the library would unpack a folder of them without a limit."""
    packed = [path for path in bags if path.name.lower().endswith(PACKED_SUFFIXES)]
    if not packed:
        has_metadata = (directory / METADATA).is_file()
        yield [directory] if has_metadata and bags[0].suffix.lower() != ".bag" else bags
        return
    with tempfile.TemporaryDirectory(prefix="roomfix-bag-", dir=scratch) as folder:
        yield [*(path for path in bags if path not in packed), *unpack_files(packed, Path(folder))]


def chosen_topics(reader: Any) -> Topics:
    """Return which of a bag's topics are read; odometry comes before poses that don't say of which frame they are."""
    if any(_VIEWER.match(connection.topic) for connection in reader.connections):
        raise InvalidScanError(OF_VIEWER)
    # A topic may have been recorded without a message; a bag without an index counts none of any.
    counted = [connection for connection in reader.connections if connection.msgcount]
    kinds = {connection.topic: connection.msgtype for connection in counted or reader.connections}
    images = [topic for topic, kind in kinds.items() if kind in IMAGES]
    depth = [topic for topic in images if "depth" in topic.lower() and not _has(topic, OTHER_WORDS)]
    color = [topic for topic in images if topic not in depth and not _has(topic, OTHER_WORDS)]
    if not color:
        there = ", ".join(sorted(kinds)[:8])
        raise InvalidScanError(f"The bag has no topic with colour images; its topics are {there or 'none'}.")
    poses = [topic for topic, kind in kinds.items() if kind in POSES and not _has(topic, TOLD_POSES)]
    odometry = [topic for topic in poses if kinds[topic] == ODOMETRY]
    return Topics(
        color=_best(color, COLOR_WORDS),
        depth=_best(depth, DEPTH_WORDS) if depth else None,
        poses=_best(odometry or poses, POSE_WORDS) if poses else None,
    )


def _has(topic: str, words: tuple[str, ...]) -> bool:
    return any(word in topic.lower() for word in words)


def _best(topics: list[str], words: tuple[str, ...]) -> str:
    def rank(topic: str) -> tuple[bool, int, int, str]:
        return (
            # Depth beside its own compression may have been compressed as a photo.
            words == DEPTH_WORDS and topic.endswith("/compressed"),
            next((i for i, word in enumerate(words) if word in topic.lower()), len(words)),
            len(topic),
            topic,
        )

    return min(topics, key=rank)


def _read(
    reader: Any, topics: Topics, files: FrameFiles
) -> tuple[_Stream, _Stream | None, list[list[float]], Transforms, str]:
    color, depth = _Stream(), _Stream()
    rows: list[list[float]] = []
    transforms, frame = Transforms(), ""
    for connection, stamp_ns, raw in reader.messages():
        wanted = connection.topic in (topics.color, topics.depth, topics.poses)
        if not wanted and connection.msgtype not in (CAMERA, *TRANSFORMS):
            continue
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic == topics.color:
            _add(color, message, files, "color")
        elif connection.topic == topics.depth:
            _add(depth, message, files, "depth")
        elif connection.msgtype == CAMERA:
            _add_camera(connection.topic, message, topics, color, depth)
        elif connection.msgtype in TRANSFORMS:
            transforms.add(message, connection.topic, stamp_ns)
        else:
            pose, frame = pose_of(message)
            rows.append([_time_s(message), *pose.translation, *pose.quaternion])
    return color, depth if depth.times_s else None, rows, transforms, frame


def _time_s(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


def _add(stream: _Stream, message: Any, files: FrameFiles, kind: str) -> None:
    name = f"{kind}/{len(stream.times_s):06d}"
    if kind == "depth" and is_depth(message):
        path = depth_of(message, files, name)
    elif kind == "color":
        path = picture_of(message, files, name)
    else:
        raise InvalidScanError(
            f"The bag's depth is encoded as {_encoding(message)}: 16UC1 and 32FC1 are read."
        )
    stream.times_s.append(_time_s(message))
    stream.paths.append(path)
    stream.frame = stream.frame or message.header.frame_id


def _encoding(message: Any) -> str:
    return str(message.encoding if hasattr(message, "encoding") else message.format)


def _add_camera(topic: str, message: Any, topics: Topics, color: _Stream, depth: _Stream) -> None:
    """Keep the intrinsics for the stream with the same namespace."""
    namespace = f"{topic.rpartition('/')[0]}/"
    for of_stream, stream in ((topics.color, color), (topics.depth, depth)):
        if of_stream is not None and of_stream.startswith(namespace) and stream.camera is None:
            stream.camera = camera_of(message, is_rectified="rect" in of_stream.removeprefix(namespace))


def _frames(
    color: _Stream,
    depth: _Stream | None,
    trajectory: Trajectory,
    options: ScanOptions,
    discarded: Discarded,
) -> list[Frame]:
    order = np.argsort(color.times_s, kind="stable").tolist()
    chosen = [order[i] for i in spaced_rows([color.times_s[i] for i in order])]
    times_s = np.array([color.times_s[i] for i in chosen])
    partners = np.full(len(chosen), -1)
    if depth is not None:
        partners = associate(times_s, np.array(depth.times_s), max(options.max_time_difference_s, 0.02))
    frames = []
    for i, time_s, partner in zip(chosen, times_s.tolist(), partners.tolist(), strict=True):
        name = f"{color.paths[i].parent.name}/{color.paths[i].stem}"
        pose = trajectory.pose_between(time_s, MAX_POSE_GAP_S, options.max_time_difference_s)
        if depth is not None and partner < 0:
            discarded.add("no_depth", name)
        elif isinstance(pose, str):
            discarded.add(pose, name)
        else:
            image = depth.paths[partner] if depth is not None else color.paths[i]
            frames.append(Frame(name, time_s, color.paths[i], image, pose))
    return frames
