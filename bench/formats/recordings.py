"""Scans as recordings of one file."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from app.geometry.se3 import Pose
from bench.formats.frames import WrittenFrame, WrittenScan

NANOSECONDS_PER_S = 1_000_000_000
BASE_FROM_CAMERA = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.1, 0.0, 0.2]))
COLOR_FRAME = "camera_color_optical_frame"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO_TOPIC = "/camera/color/camera_info"


def millimetres(frame: WrittenFrame) -> tuple[str, bytes]:
    """Return a frame's depth as a message's encoding and data: 16 bits in millimetres."""
    return "16UC1", np.ascontiguousarray(frame.depth_mm).tobytes()


@dataclass(frozen=True, slots=True, kw_only=True)
class BagKind:
    """What a recorder puts into a bag: encoding and data of depth, whether images are compressed, poses on a topic or
    as transforms, and the lens that it states."""

    depth: Callable[[WrittenFrame], tuple[str, bytes]] = millimetres
    compressed_depth: bool = False
    compressed_color: bool = False
    poses_as_transforms: bool = False
    lens: tuple[float, ...] = (0.0,) * 5
    lens_model: str = "plumb_bob"
    states_camera: bool = True
    has_poses: bool = True
    prefix: str = "/camera"
    depth_frame: str = COLOR_FRAME
    depth_name: str = "aligned_depth_to_color"

    @property
    def color_topic(self) -> str:
        """The topic of colour."""
        return f"{self.prefix}/color/image_raw" + ("/compressed" if self.compressed_color else "")

    @property
    def depth_topic(self) -> str:
        """The topic of depth."""
        end = "/compressedDepth" if self.compressed_depth else ""
        return f"{self.prefix}/{self.depth_name}/image_raw{end}"

    @property
    def topics(self) -> dict[str, str]:
        """The types of all topics."""
        return {
            self.color_topic: COMPRESSED if self.compressed_color else IMAGE,
            INFO_TOPIC: "sensor_msgs/msg/CameraInfo",
            self.depth_topic: COMPRESSED if self.compressed_depth else IMAGE,
            "/tf" if self.poses_as_transforms else "/odom": "tf2_msgs/msg/TFMessage"
            if self.poses_as_transforms
            else "nav_msgs/msg/Odometry",
            "/tf_static": "tf2_msgs/msg/TFMessage",
        }


REALSENSE = BagKind()


def sens(scan: WrittenScan, target: Path) -> Path:
    """Write a `.sens` file."""
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_suffix(".sens")
    K = np.eye(4, dtype="<f4")
    K[:3, :3] = scan.matrix
    height, width = scan.frames[0].depth_m.shape
    name = b"StructureSensor"
    with path.open("wb") as file:
        file.write(struct.pack("<IQ", 4, len(name)) + name)
        for matrix in (K, np.eye(4, dtype="<f4"), K, np.eye(4, dtype="<f4")):
            file.write(matrix.tobytes())
        file.write(struct.pack("<2i", 2, 1))
        file.write(struct.pack("<4I", scan.camera.width, scan.camera.height, width, height))
        file.write(struct.pack("<fQ", 1000.0, len(scan.frames)))
        for frame in scan.frames:
            color, depth = frame.jpeg, zlib.compress(frame.depth_mm.astype("<u2").tobytes())
            time_us = round(1e6 * frame.time_s)
            file.write(frame.scan_from_camera.matrix.astype("<f4").tobytes())
            file.write(struct.pack("<4Q", time_us, time_us, len(color), len(depth)) + color + depth)
        file.write(struct.pack("<Q", 0))
    return path


def rtabmap(scan: WrittenScan, target: Path, depth_as_floats: bool = False) -> Path:
    """Write a database of RTAB-Map with optimized poses; those of the nodes drift."""
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_suffix(".db")
    path.unlink(missing_ok=True)
    bases = [frame.scan_from_camera @ BASE_FROM_CAMERA.inverse() for frame in scan.frames]
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(
            "CREATE TABLE Node (id INTEGER PRIMARY KEY, map_id INTEGER, stamp FLOAT, pose BLOB)"
        )
        connection.execute(
            "CREATE TABLE Data (id INTEGER PRIMARY KEY, image BLOB, depth BLOB, calibration BLOB)"
        )
        connection.execute("CREATE TABLE Admin (version TEXT, opt_ids BLOB, opt_poses BLOB)")
        for i, (frame, base) in enumerate(zip(scan.frames, bases, strict=True), start=1):
            drifting = base.matrix[:3].astype("<f4")
            drifting[:, 3] *= 1.05
            connection.execute("INSERT INTO Node VALUES (?, 0, ?, ?)", (i, frame.time_s, drifting.tobytes()))
            depth = _float_png(frame.depth_m) if depth_as_floats else frame.depth_png
            connection.execute(
                "INSERT INTO Data VALUES (?, ?, ?, ?)", (i, frame.jpeg, depth, _calibration(scan))
            )
        ids = np.arange(1, len(bases) + 1, dtype="<i4")
        poses = np.stack([base.matrix[:3] for base in bases]).astype("<f4")
        connection.execute("INSERT INTO Admin VALUES ('0.21.4', ?, ?)", (_packed(ids, 4), _packed(poses, 5)))
    return path


def _packed(values: np.ndarray[Any, Any], kind: int) -> bytes:
    return zlib.compress(values.tobytes()) + struct.pack("<3i", 1, values.size, kind)


def _float_png(depth_m: np.ndarray[Any, np.dtype[np.float32]]) -> bytes:
    height, width = depth_m.shape
    pixels = depth_m.astype("<f4").view(np.uint8).reshape(height, width, 4)
    return cv2.imencode(".png", pixels)[1].tobytes()


def _calibration(scan: WrittenScan) -> bytes:
    header = struct.pack("<11i", 0, 21, 4, 0, scan.camera.width, scan.camera.height, 9, 5, 0, 0, 12)
    numbers = scan.matrix.astype("<f8").tobytes() + np.zeros(5).tobytes()
    return header + numbers + BASE_FROM_CAMERA.matrix[:3].astype("<f4").tobytes()


def ros1(scan: WrittenScan, target: Path, kind: BagKind = REALSENSE) -> Path:
    """Write a ROS 1 bag of a RealSense with odometry of the base."""
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_suffix(".bag")
    path.unlink(missing_ok=True)
    with Ros1Writer(path) as writer:
        _write_bag(scan, writer, "1", kind)
    return path


def ros2(
    storage: StoragePlugin,
    scan: WrittenScan,
    target: Path,
    kind: BagKind = REALSENSE,
    *,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Write a folder with a ROS 2 bag of a RealSense with odometry of the base, compressed by zstd or not."""
    target.parent.mkdir(parents=True, exist_ok=True)
    opened = Ros2Writer(target, version=9, storage_plugin=storage)
    opened.set_compression(compression, CompressionFormat.ZSTD)
    with opened as writer:
        _write_bag(scan, writer, "2", kind)
    return target


def ros2_sqlite(scan: WrittenScan, target: Path) -> Path:
    """Write a ROS 2 bag as SQLite (`.db3`)."""
    return ros2(StoragePlugin.SQLITE3, scan, target)


def ros2_mcap(scan: WrittenScan, target: Path) -> Path:
    """Write a ROS 2 bag as MCAP."""
    return ros2(StoragePlugin.MCAP, scan, target)


class _Bag:
    """Makes the messages of a bag in the types of ROS 1 or ROS 2, and writes them."""

    def __init__(self, writer: Any, version: Literal["1", "2"], topics: Mapping[str, str]) -> None:
        self.version, self.topics = version, topics
        self.store = get_typestore(Stores.ROS1_NOETIC if version == "1" else Stores.ROS2_HUMBLE)
        if version == "1":
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        self.types: Any = self.store.types
        self.writer = writer
        self.connections = {
            topic: writer.add_connection(topic, kind, typestore=self.store) for topic, kind in topics.items()
        }

    def send(self, topic: str, time_ns: int, message: Any) -> None:
        serialize = self.store.serialize_ros1 if self.version == "1" else self.store.serialize_cdr
        self.writer.write(self.connections[topic], time_ns, serialize(message, self.topics[topic]))

    def header(self, time_ns: int, frame: str) -> Any:
        seconds, nanoseconds = divmod(time_ns, NANOSECONDS_PER_S)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        extra = {"seq": 0} if self.version == "1" else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **extra)

    def vector(self, kind: str, values: Any) -> Any:
        x, y, z = (float(v) for v in values)
        return self.types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)

    def quaternion(self, pose: Pose) -> Any:
        x, y, z, w = (float(v) for v in pose.quaternion)
        return self.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def _write_bag(scan: WrittenScan, writer: Any, version: Literal["1", "2"], kind: BagKind) -> None:
    bag = _Bag(writer, version, kind.topics)
    start_ns = round(1e9 * scan.frames[0].time_s)
    bag.send("/tf_static", start_ns, _transform(bag, start_ns, ("base_link", COLOR_FRAME), BASE_FROM_CAMERA))
    if kind.states_camera:
        info = _camera_info(scan, bag.types, bag.header(start_ns, COLOR_FRAME), version, kind)
        bag.send(INFO_TOPIC, start_ns, info)
    for frame in scan.frames:
        time_ns = round(1e9 * frame.time_s)
        base = frame.scan_from_camera @ BASE_FROM_CAMERA.inverse()
        if not kind.has_poses:
            pass
        elif kind.poses_as_transforms:
            bag.send("/tf", time_ns, _transform(bag, time_ns, ("odom", "base_link"), base))
        else:
            bag.send("/odom", time_ns, _odometry(bag, time_ns, base))
        header = bag.header(time_ns, COLOR_FRAME)
        rgb = np.ascontiguousarray(cv2.cvtColor(frame.bgr, cv2.COLOR_BGR2RGB))
        color = (
            ("rgb8; jpeg compressed bgr8", frame.jpeg) if kind.compressed_color else ("rgb8", rgb.tobytes())
        )
        bag.send(kind.color_topic, time_ns, _image(bag.types, header, rgb.shape, *color))
        of_depth = bag.header(time_ns, kind.depth_frame)
        depth = _image(bag.types, of_depth, frame.depth_m.shape, *kind.depth(frame))
        bag.send(kind.depth_topic, time_ns, depth)


def _transform(bag: _Bag, time_ns: int, frames: tuple[str, str], parent_from_child: Pose) -> Any:
    placed = bag.types["geometry_msgs/msg/TransformStamped"](
        header=bag.header(time_ns, frames[0]),
        child_frame_id=frames[1],
        transform=bag.types["geometry_msgs/msg/Transform"](
            translation=bag.vector("Vector3", parent_from_child.translation),
            rotation=bag.quaternion(parent_from_child),
        ),
    )
    return bag.types["tf2_msgs/msg/TFMessage"](transforms=[placed])


def _odometry(bag: _Bag, time_ns: int, base: Pose) -> Any:
    pose = bag.types["geometry_msgs/msg/Pose"](
        position=bag.vector("Point", base.translation), orientation=bag.quaternion(base)
    )
    zero = bag.vector("Vector3", (0, 0, 0))
    still = bag.types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    return bag.types["nav_msgs/msg/Odometry"](
        header=bag.header(time_ns, "odom"),
        child_frame_id="base_link",
        pose=bag.types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
        twist=bag.types["geometry_msgs/msg/TwistWithCovariance"](twist=still, covariance=np.zeros(36)),
    )


def _image(T: Any, header: Any, shape: tuple[int, ...], encoding: str, data: bytes) -> Any:
    """Return a message of an image; the encoding of a compressed one names its compression."""
    values = np.frombuffer(data, np.uint8)
    if "compressed" in encoding.lower():
        return T[COMPRESSED](header=header, format=encoding, data=values)
    return T[IMAGE](
        header=header,
        height=shape[0],
        width=shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=len(data) // shape[0],
        data=values,
    )


def _camera_info(scan: WrittenScan, T: Any, header: Any, version: Literal["1", "2"], kind: BagKind) -> Any:
    K = scan.matrix.ravel()
    P = np.hstack([scan.matrix, np.zeros((3, 1))]).ravel()
    matrices = {"D": np.array(kind.lens), "K": K, "R": np.eye(3).ravel(), "P": P}
    named = {name if version == "1" else name.lower(): values for name, values in matrices.items()}
    region = T["sensor_msgs/msg/RegionOfInterest"](
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return T["sensor_msgs/msg/CameraInfo"](
        header=header,
        height=scan.camera.height,
        width=scan.camera.width,
        distortion_model=kind.lens_model,
        binning_x=0,
        binning_y=0,
        roi=region,
        **named,
    )
