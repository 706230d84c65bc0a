"""The frame source: what a scan of any format becomes before a map is built from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.depth import register_depth
from app.geometry.se3 import Pose
from app.geometry.uniform_motion import UniformMotion

RAW_DEPTH_SATURATED = 65535  # written by several recorders for "no measurement"; 0 is the other such value


@dataclass(frozen=True, slots=True)
class Frame:
    """One colour image with its depth image and its pose.

    `name` is the colour file's path below the scan's folder, `timestamp_s` the colour image's time.
    """

    name: str
    timestamp_s: float
    color: Path
    depth: Path
    scan_from_camera: Pose


@dataclass(frozen=True, slots=True)
class DepthFormat:
    """How the depth files are to be read.

    `scale` is in units per metre. Without `camera` the depth is registered to the colour image, pixel by
    pixel; with it, the depth has a camera of its own, and `color_from_depth` moves points to the colour
    camera.
    """

    scale: float
    camera: Camera | None = None
    color_from_depth: Pose = field(default_factory=Pose.identity)
    encoding: Literal["png16"] = "png16"


@dataclass(frozen=True, slots=True)
class ScanOptions:
    """What a caller may say about a scan; everything left out comes from the files or the format's default.

    `camera` and `depth_camera` are a `Camera` or 4, 8 or 9 numbers `fx fy cx cy [k1 k2 p1 p2 [k3]]`, which
    then get the images' size. `depth_scale` is in units per metre. `color_from_depth` needs a `depth_camera`.
    `max_time_difference_s` is how far apart the times of colour, depth and pose may be. `motion` stands in for
    the poses of a scan that has none. Raises `InvalidInputError` for values that can't be meant.
    """

    camera: Camera | tuple[float, ...] | None = None
    depth_scale: float | None = None
    depth_camera: Camera | tuple[float, ...] | None = None
    color_from_depth: Pose | None = None
    max_time_difference_s: float = 0.02
    motion: UniformMotion | None = None

    def __post_init__(self) -> None:
        if self.depth_scale is not None and not 0 < self.depth_scale < math.inf:
            raise InvalidInputError("depth_scale must be a number above 0, in units per metre.")
        if not 0 <= self.max_time_difference_s < math.inf:
            raise InvalidInputError("max_time_difference_s must be 0 or more seconds.")
        if self.color_from_depth is not None and self.depth_camera is None:
            raise InvalidInputError(
                "color_from_depth needs depth_camera: the intrinsics of the depth images."
            )


class FrameSource(Protocol):
    """What a build needs of a scan; `Scan` is the one for files."""

    @property
    def camera(self) -> Camera:
        """The camera of the colour images."""

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The usable frames in time order."""

    @property
    def discarded(self) -> Mapping[str, tuple[str, ...]]:
        """The names of the frames left out, by reason."""

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        """The unit direction of down in the scan's frame, if known."""

    def color_bytes(self, frame: Frame) -> bytes:
        """Return the colour image's file contents."""

    def depth_m(self, frame: Frame) -> NDArray[np.float32]:
        """Return the z-depth (height, width) in metres registered to the colour image, 0 = invalid."""


@dataclass(frozen=True, slots=True)
class Scan:
    """Frames with depth and pose, in time order, and what was left out and why.

    `discarded` maps a reason (`no_depth`, `no_pose`, `invalid_pose`, `missing_file`, `unreadable_file`) to
    the names of the colour images. `gravity` is the unit direction of down in the scan's frame, if known.
    """

    camera: Camera
    frames: tuple[Frame, ...]
    discarded: Mapping[str, tuple[str, ...]]
    depth: DepthFormat
    gravity: tuple[float, float, float] | None = None

    def color_bytes(self, frame: Frame) -> bytes:
        """Return the contents of the colour image's file; raises `InvalidScanError` if it can't be read."""
        return _read(frame.color, frame.name)

    def depth_m(self, frame: Frame) -> NDArray[np.float32]:
        """Return the z-depth (height, width) in metres, registered to the colour image; 0 where not known.

        Raw values 0 and 65535 are invalid. Raises `InvalidScanError` for a file that is no 16-bit depth image
        of the expected size.
        """
        raw = _decode_depth(_read(frame.depth, frame.name), frame.depth.name)
        source = self.depth.camera or self.camera
        if raw.shape != (source.height, source.width):
            raise InvalidScanError(
                f"{frame.depth.name} has {raw.shape[1]} x {raw.shape[0]} pixels where "
                f"{source.width} x {source.height} are expected."
            )
        depth_m = raw.astype(np.float32) / np.float32(self.depth.scale)
        depth_m[raw == RAW_DEPTH_SATURATED] = 0.0
        if self.depth.camera is None:
            return depth_m
        return register_depth(depth_m, self.depth.camera, self.camera, self.depth.color_from_depth)


def _read(path: Path, frame_name: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidScanError(
            f"{path.name} of frame {frame_name} can't be read: {error.strerror}."
        ) from None


def _decode_depth(data: bytes, name: str) -> NDArray[np.uint16]:
    try:
        raw = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        raw = None
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2:
        raise InvalidScanError(
            f"{name} is not a PNG with one channel of 16 bits, so it can't be a depth image."
        )
    return np.asarray(raw, dtype=np.uint16)
