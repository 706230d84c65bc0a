"""The frame source: what a scan of any format becomes before a map is built from it."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidInputError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.depth import register_depth
from app.geometry.se3 import Pose
from app.geometry.uniform_motion import UniformMotion
from app.importers.association import Trajectory
from app.importers.conventions import PoseConvention
from app.importers.images.depth_files import read_depth

# Written into 16 bits by several recorders for "no measurement"; 0 is the other such value.
RAW_DEPTH_SATURATED = 65535
# ARKit's levels are 0 (low), 1 (medium) and 2 (high); other apps spread them over 0 to 255, low being 0 there too.
LOW_CONFIDENCE = 0
NUMPY_MAGIC = b"\x93NUMPY"


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


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthFormat:
    """How the depth files are to be read.

    `scale` is in units per metre for images of integers, `float_scale` for images of floats; `is_stated` is false
    where nothing but the format's usual unit says so. Without `camera` the depth is registered to the colour image,
    pixel by pixel; with it, the depth has a camera of its own, and `color_from_depth` moves points to the colour
    camera. `swap_bytes` exchanges the two bytes of each value of 16 bits; `along_rays` says that the values are
    distances along the rays, not along the optical axis; `shift_px` moves the registered depth to the right and
    down. `confidence` maps a depth file to the image of its pixels' confidence, in the depth's own pixels; depth of
    low confidence, 0, is invalid.
    """

    scale: float
    camera: Camera | None = None
    color_from_depth: Pose = field(default_factory=Pose.identity)
    float_scale: float = 1.0
    swap_bytes: bool = False
    along_rays: bool = False
    shift_px: tuple[int, int] = (0, 0)
    confidence: Mapping[Path, Path] = field(default_factory=dict)
    is_stated: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanOptions:
    """What a caller may say about a scan; everything left out comes from the files or the format's default.

    `camera` and `depth_camera` that are only numbers get the images' size. `depth_scale` is in units per metre.
    `color_from_depth` needs a `depth_camera`. `max_time_difference_s` is how far apart the times of colour, depth and
    pose may be. `motion` stands in for the poses of a scan that has none; `estimate_poses` says that no poses are read,
    since they are estimated from the pictures. `convention` is how the poses are written; the next three are as in
    `DepthFormat`. `scratch` is the folder for the frames of recordings, by default that of the system. Raises
    `InvalidInputError` for values that can't be meant.
    """

    camera: CameraHint | None = None
    depth_scale: float | None = None
    depth_camera: CameraHint | None = None
    color_from_depth: Pose | None = None
    max_time_difference_s: float = 0.02
    motion: UniformMotion | None = None
    estimate_poses: bool = False
    convention: PoseConvention = PoseConvention()
    swap_depth_bytes: bool = False
    depth_along_rays: bool = False
    depth_shift_px: tuple[int, int] = (0, 0)
    scratch: Path | None = field(default=None, compare=False)

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

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what the files left open and how it was read."""

    @property
    def has_depth(self) -> bool:
        """Whether the frames have depth images; without them all depth is 0."""

    @property
    def has_scale(self) -> bool:
        """Whether positions and depth are in metres; without it they are in a unit of the scan's own."""

    def color_bytes(self, frame: Frame) -> bytes:
        """Return the colour image's file contents."""

    def depth_m(self, frame: Frame) -> NDArray[np.float32]:
        """Return the z-depth (height, width) in metres registered to the colour image, 0 = invalid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Frames with depth and pose, in time order, and what was left out and why.

    `discarded` maps a reason (`no_depth`, `no_pose`, `invalid_pose`, `missing_file`, `unreadable_file`) to
    the names of the colour images. `gravity` is the unit direction of down in the scan's frame, if known. `notes` are
    sentences on what the files left open and how it was read. `trajectory` holds the rows that the poses are from, as
    they are written, where a format has more of them than frames. Without `has_depth` the depth images are blank, and
    points have to be triangulated. Without `has_scale` positions are in a unit of their own, not metres. `left_out` are
    those of the discarded frames that have no file of their name below the scan's folder. Without `has_times` the times
    of frames say no more than their order. `keeps` holds what must live as long as the scan: the folder of unpacked
    frames.
    """

    camera: Camera
    frames: tuple[Frame, ...]
    discarded: Mapping[str, tuple[str, ...]]
    depth: DepthFormat
    gravity: tuple[float, float, float] | None = None
    notes: tuple[str, ...] = ()
    trajectory: Trajectory | None = None
    has_depth: bool = True
    has_scale: bool = True
    left_out: tuple[Frame, ...] = ()
    has_times: bool = True
    keeps: object = field(default=None, compare=False, repr=False)

    def color_bytes(self, frame: Frame) -> bytes:
        """Return the contents of the colour image's file; raises `InvalidScanError` if it can't be read."""
        return _read(frame.color, frame.name)

    def depth_m(self, frame: Frame) -> NDArray[np.float32]:
        """Return the z-depth (height, width) in metres, registered to the colour image; 0 where not known.

        Values of 0 and below, 65535 in 16 bits, and what is not finite are invalid. Raises `InvalidScanError` for a
        file that is no depth image of the expected size.
        """
        raw = read_depth(_read(frame.depth, frame.name), frame.depth.name)
        source = self.depth.camera or self.camera
        if raw.shape != (source.height, source.width):
            raise InvalidScanError(
                f"{frame.depth.name} has {raw.shape[1]} x {raw.shape[0]} pixels where "
                f"{source.width} x {source.height} are expected."
            )
        depth_m = metres(raw, self.depth)
        if frame.depth in self.depth.confidence:
            depth_m[is_of_low_confidence(self.depth.confidence[frame.depth], depth_m.shape)] = 0.0
        if self.depth.along_rays:
            depth_m /= _ray_lengths(source)
        if self.depth.camera is not None:
            depth_m = register_depth(depth_m, self.depth.camera, self.camera, self.depth.color_from_depth)
        return depth_m if self.depth.shift_px == (0, 0) else _shifted(depth_m, self.depth.shift_px)


def metres(raw: NDArray[np.generic], depth: DepthFormat) -> NDArray[np.float32]:
    """Return the values of a depth image in metres, 0 where they are invalid."""
    is_float = raw.dtype.kind == "f"
    if depth.swap_bytes and raw.dtype == np.uint16:
        raw = raw.byteswap()
    depth_m = raw.astype(np.float32) / np.float32(depth.float_scale if is_float else depth.scale)
    if raw.dtype == np.uint16:
        depth_m[raw == np.uint16(RAW_DEPTH_SATURATED)] = 0.0
    else:
        depth_m[~(np.isfinite(depth_m) & (depth_m > 0))] = 0.0
    return depth_m


def is_of_low_confidence(path: Path, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which pixels of a depth image (height, width) have low confidence by the image beside it."""
    confidence = _confidence(path.read_bytes())
    if confidence is None:
        raise InvalidScanError(f"{path.name} is not an image, so it can't hold the depth's confidence.")
    if confidence.ndim == 3:
        confidence = confidence[..., 0]
    if confidence.shape == shape:
        return np.asarray(confidence == LOW_CONFIDENCE)
    resized = cv2.resize(confidence, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized == LOW_CONFIDENCE)


def _confidence(data: bytes) -> NDArray[np.uint8] | None:
    """Return the values of an image of bytes, or of such a NumPy array; None for anything else."""
    if data.startswith(NUMPY_MAGIC):
        try:
            values = np.load(io.BytesIO(data), allow_pickle=False)
        except (ValueError, OSError, EOFError):
            return None
        is_image = values.ndim == 2 and values.dtype.itemsize == 1
        return np.asarray(values, dtype=np.uint8) if is_image else None
    # OpenCV raises its own error for no bytes at all.
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    return None if image is None else np.asarray(image, dtype=np.uint8)


@lru_cache(maxsize=4)
def _ray_lengths(camera: Camera) -> NDArray[np.float32]:
    """Return the length (height, width) of each pixel's ray at z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width]
    plane = camera.normalize(np.stack([u, v], axis=-1).reshape(-1, 2))
    lengths = np.sqrt(1.0 + (plane**2).sum(axis=1))
    return np.asarray(lengths.reshape(camera.height, camera.width), dtype=np.float32)


def _shifted(depth_m: NDArray[np.float32], shift_px: tuple[int, int]) -> NDArray[np.float32]:
    """Return depth moved to the right and down; 0 where nothing is moved to."""
    height, width = depth_m.shape
    right, down = shift_px
    moved = np.zeros_like(depth_m)
    if abs(right) < width and abs(down) < height:
        moved[max(down, 0) : height + min(down, 0), max(right, 0) : width + min(right, 0)] = depth_m[
            max(-down, 0) : height + min(-down, 0), max(-right, 0) : width + min(-right, 0)
        ]
    return moved


def _read(path: Path, frame_name: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidScanError(
            f"{path.name} of frame {frame_name} can't be read: {error.strerror}."
        ) from None
