"""From candidate frames to a `Scan`: the checks that every format shares."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from app.errors import InvalidCameraError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.importers.frames import DepthFormat, Frame, Scan, ScanOptions
from app.importers.scan_files import color_size, depth_size

# A format whose poses are mostly broken is read wrongly; leaving out most of a scan would hide it.
MAX_INVALID_POSE_SHARE = 0.5

Size = tuple[int, int]
Intrinsics = Camera | tuple[float, ...]


@dataclass(slots=True)
class Discarded:
    """The colour images left out, by reason, in the order in which they were met."""

    names: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def add(self, reason: str, name: str) -> None:
        """Note that the frame `name` is left out for `reason`."""
        self.names[reason].append(name)

    def summary(self) -> str:
        """Return the counts in words, such as `3 no_depth, 1 no_pose`."""
        return (
            ", ".join(f"{len(names)} {reason}" for reason, names in self.names.items()) or "no frames at all"
        )


@dataclass(frozen=True, slots=True)
class ScanSource:
    """What a format's files say: intrinsics, units per metre of depth, and the direction of down if known."""

    camera: Intrinsics
    depth_scale: float
    gravity: tuple[float, float, float] | None


def assemble_scan(
    frames: Sequence[Frame], discarded: Discarded, source: ScanSource, options: ScanOptions
) -> Scan:
    """Return the scan of the candidate frames whose images can be read, in time order.

    Intrinsics given as numbers get the size of the first image. Raises `InvalidScanError` when no frame is
    left, or an image's size is not its camera's.
    """
    readable: list[tuple[Frame, Size, Size]] = []
    for frame in sorted(frames, key=lambda f: f.timestamp_s):
        sizes = color_size(frame.color), depth_size(frame.depth)
        if sizes[0] is None or sizes[1] is None:
            discarded.add("unreadable_file", frame.name)
        else:
            readable.append((frame, sizes[0], sizes[1]))
    if not readable:
        raise InvalidScanError(f"No frame of the scan can be used: {discarded.summary()}.")
    camera = _camera(source.camera, readable[0][1], "camera")
    depth = _depth_format(source.depth_scale, readable[0][2], options)
    for frame, color, depth_pixels in readable:
        _check_sizes(frame, color, depth_pixels, camera, depth.camera)
    names = {reason: tuple(names) for reason, names in discarded.names.items()}
    return Scan(camera, tuple(frame for frame, _, _ in readable), names, depth, source.gravity)


def check_pose_share(invalid: int, total: int, example: str) -> None:
    """Raise `InvalidScanError` if half of the poses or more can't be used; `example` names one of them."""
    if invalid and invalid >= MAX_INVALID_POSE_SHARE * total:
        raise InvalidScanError(
            f"{invalid} of {total} poses are not finite numbers with a rotation, {example} among them: "
            "check the order of the columns."
        )


def relative_name(path: Path, directory: Path) -> str:
    """Return the path below the scan's folder, with forward slashes."""
    return path.relative_to(directory).as_posix()


def _camera(intrinsics: Intrinsics, size: Size, name: str) -> Camera:
    if isinstance(intrinsics, Camera):
        return intrinsics
    try:
        return Camera.from_values(intrinsics, *size)
    except InvalidCameraError as error:
        raise InvalidScanError(f"{name}: {error}") from None


def _depth_format(scale: float, size: Size, options: ScanOptions) -> DepthFormat:
    if options.depth_camera is None:
        return DepthFormat(scale)
    camera = _camera(options.depth_camera, size, "depth_camera")
    return DepthFormat(scale, camera, options.color_from_depth or Pose.identity())


def _check_sizes(frame: Frame, color: Size, depth: Size, camera: Camera, depth_camera: Camera | None) -> None:
    if color != (camera.width, camera.height):
        raise InvalidScanError(
            f"{frame.name} has {color[0]} x {color[1]} pixels, but the camera is for "
            f"{camera.width} x {camera.height}: give the intrinsics of these images, all of one size."
        )
    if depth_camera is not None and depth != (depth_camera.width, depth_camera.height):
        raise InvalidScanError(
            f"{frame.depth.name} has {depth[0]} x {depth[1]} pixels, but the depth camera is for "
            f"{depth_camera.width} x {depth_camera.height}: give the intrinsics of the depth images."
        )
    if depth_camera is None and depth != color:
        raise InvalidScanError(
            f"{frame.depth.name} has {depth[0]} x {depth[1]} pixels, its colour image {frame.name} has "
            f"{color[0]} x {color[1]}: register the depth to the colour image, or give depth_camera."
        )
