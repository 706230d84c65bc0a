"""From candidate frames to a `Scan`: the checks that every format shares."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from app.errors import InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.se3 import Pose
from app.importers.frames import DepthFormat, Frame, Scan, ScanOptions
from app.importers.images.color_files import color_size
from app.importers.images.depth_files import DepthHeader, read_depth, read_depth_header
from app.importers.scan_camera import camera_stated_in
from app.importers.unpacked import WITHOUT_DEPTH, FrameFiles
from app.limits import limit

Size = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class AssemblyOptions:
    """When a scan is taken to be read wrongly, and which float depth makes sense."""

    max_invalid_pose_ratio: float = limit(
        0.5,
        "A scan with this ratio of invalid poses, or a larger one, is refused.",
        chosen="By hand: leaving out most of a scan would hide that its columns are read in the wrong order.",
    )
    max_position: float = limit(
        1e11,
        "A coordinate beyond this, in whatever unit positions have, is no place.",
        chosen="By hand: ten times the circumference of Earth in millimetres.",
    )
    min_median_depth_m: float = limit(
        0.05,
        "Float depth whose median is nearer is not in metres.",
        chosen="By hand: nearer than any depth sensor measures.",
    )
    max_median_depth_m: float = limit(
        60.0, "Float depth whose median is farther is not in metres.", chosen="By hand: the longest halls."
    )
    depth_images_sampled: int = limit(
        3, "Float depth images that are read to find their unit.", chosen="By hand: one of them may be blank."
    )


OPTIONS = AssemblyOptions()
MILLIMETRES_PER_M = 1000.0
# Reasons whose first case is worth a note: a file is wrong, while times that don't meet are common.
FIRST_OF = {
    "missing_file": "The first missing file",
    "unreadable_file": "The first unreadable file",
    "no_depth": "The first without depth",
    "no_pose": "The first without a pose",
}
OF_FILES = ("missing_file", "unreadable_file")


@dataclass(slots=True)
class Discarded:
    """The colour images left out, by reason, in the order in which they were met."""

    names: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    details: dict[str, str] = field(default_factory=dict)

    def add(self, reason: str, name: str, detail: str = "") -> None:
        """Note that the frame `name` is left out for `reason`; of the details, the first of a reason is kept."""
        self.names[reason].append(name)
        if detail:
            self.details.setdefault(reason, detail)

    def summary(self) -> str:
        """Return the counts in words, such as `3 no_depth, 1 no_pose`, with the first detail of each reason."""
        if not self.names:
            return "no frames at all."
        counts = ", ".join(f"{len(names)} {reason}" for reason, names in self.names.items())
        return " ".join([f"{counts}.", *self.sentences(*self.details)])

    def sentences(self, *reasons: str) -> list[str]:
        """Return the first details of these reasons, a sentence each."""
        return [
            f"{FIRST_OF[reason]}: {self.details[reason]}." for reason in reasons if reason in self.details
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSource:
    """What a format's files say: depth units per metre, intrinsics, the direction of down, and how they were read.

    A `camera` without values is stated by the options, or by the pictures' own ones.
    `depth_scale` is None when neither options nor files state it; `default_depth_scale` is the format's own. A depth
    camera is only needed for a depth of its own; options come first. `confidence` maps depth files to the images of
    their confidence. Without `has_depth` a frame's picture stands for its depth, which becomes a blank
    image. `keeps` must live as long as the scan.
    """

    depth_scale: float | None
    default_depth_scale: float
    camera: CameraHint = CameraHint()
    gravity: tuple[float, float, float] | None = None
    depth_camera: CameraHint | None = None
    notes: tuple[str, ...] = ()
    confidence: Mapping[Path, Path] = field(default_factory=dict)
    has_depth: bool = True
    keeps: FrameFiles | None = None


def assemble_scan(
    frames: Sequence[Frame], discarded: Discarded, source: ScanSource, options: ScanOptions
) -> Scan:
    """Return the scan of the candidate frames whose images can be read, in time order.

    Intrinsics given as numbers get the size of the first image. A scan without depth says so, and has blank depth
    images. Raises `InvalidScanError` when no frame is left, or an image's size is not its camera's.
    """
    if not source.has_depth:
        frames, source = _without_depth(frames, source, options)
    frames = _placed(frames, discarded)
    readable: list[tuple[Frame, Size, DepthHeader]] = []
    for frame in sorted(frames, key=lambda f: f.timestamp_s):
        color, depth_header = color_size(frame.color), read_depth_header(frame.depth)
        if color is None or depth_header is None:
            unreadable = frame.color if color is None else frame.depth
            detail = f"{unreadable.name} of frame {frame.name}, empty, damaged or in an unknown format"
            discarded.add("unreadable_file", frame.name, detail)
        else:
            readable.append((frame, color, depth_header))
    if not readable:
        raise InvalidScanError(f"No frame of the scan can be used: {discarded.summary()}")
    camera = _camera(source.camera, readable[0][1], "camera")
    first_depth = readable[0][2].width, readable[0][2].height
    depth, notes = _depth_format(source, camera, readable, first_depth, options)
    for frame, color, depth_header in readable:
        _check_sizes(frame, color, (depth_header.width, depth_header.height), camera, depth.camera)
    return Scan(
        camera=camera,
        frames=tuple(frame for frame, _, _ in readable),
        discarded={reason: tuple(names) for reason, names in discarded.names.items()},
        depth=depth,
        gravity=source.gravity,
        notes=(*source.notes, *notes, *discarded.sentences(*OF_FILES)),
        has_depth=source.has_depth,
        keeps=source.keeps,
    )


def _placed(frames: Sequence[Frame], discarded: Discarded) -> list[Frame]:
    """Return the frames whose position is one on Earth in whatever unit; a damaged number may be any other."""
    placed = []
    for frame in frames:
        if np.abs(frame.scan_from_camera.translation).max() <= OPTIONS.max_position:
            placed.append(frame)
        else:
            discarded.add("invalid_pose", frame.name)
    wrong = len(frames) - len(placed)
    check_pose_ratio(wrong, len(frames), f"that of {discarded.names['invalid_pose'][-1]}" if wrong else "")
    return placed


def _without_depth(
    frames: Sequence[Frame], source: ScanSource, options: ScanOptions
) -> tuple[list[Frame], ScanSource]:
    files = source.keeps or FrameFiles(options.scratch)
    size = next(filter(None, (color_size(frame.color) for frame in frames)), (1, 1))
    blank = files.blank_depth(*size)
    return (
        [replace(frame, depth=blank) for frame in frames],
        replace(source, notes=(WITHOUT_DEPTH, *source.notes), keeps=files),
    )


def check_pose_ratio(invalid: int, total: int, example: str) -> None:
    """Raise `InvalidScanError` if half of the poses or more can't be used; `example` names one and its fault."""
    if invalid and invalid >= OPTIONS.max_invalid_pose_ratio * total:
        raise InvalidScanError(
            f"{invalid} of {total} poses are not finite numbers with a rotation, {example} among them: "
            "check the order of the columns."
        )


def _camera(stated: CameraHint, size: Size, name: str) -> Camera:
    if stated.camera is not None:
        return stated.camera
    with camera_stated_in(name):
        return Camera.from_values(stated.values, *size)


def _depth_format(
    source: ScanSource,
    camera: Camera,
    readable: list[tuple[Frame, Size, DepthHeader]],
    size: Size,
    options: ScanOptions,
) -> tuple[DepthFormat, tuple[str, ...]]:
    scale = options.depth_scale or source.depth_scale
    if scale is not None and not 0 < scale < np.inf:
        raise InvalidScanError(
            f"The scan's files state {scale:g} units of depth per metre: give depth_scale in the options."
        )
    of_floats = [frame for frame, _, header in readable if header.is_float]
    float_scale, notes = _float_scale(of_floats, scale) if of_floats else (1.0, ())
    given = (options.depth_camera or source.depth_camera) if source.has_depth else None
    depth_camera = None if given is None else _camera(given, size, "depth_camera")
    if depth_camera is None and _is_scaled(size, camera):
        with camera_stated_in(readable[0][0].depth.name):
            depth_camera = camera.scaled_to(*size)
        notes = (
            *notes,
            f"Depth has {size[0]} x {size[1]} pixels, colour {camera.width} x {camera.height}: depth was read as the "
            "same field of view, with intrinsics scaled to its size.",
        )
    color_from_depth = options.color_from_depth or Pose.identity()
    return (
        DepthFormat(
            scale=scale or source.default_depth_scale,
            camera=depth_camera,
            color_from_depth=color_from_depth,
            float_scale=float_scale,
            swap_bytes=options.swap_depth_bytes,
            along_rays=options.depth_along_rays,
            shift_px=options.depth_shift_px,
            confidence=source.confidence,
            is_stated=scale is not None or bool(of_floats),
        ),
        notes,
    )


def _is_scaled(size: Size, camera: Camera) -> bool:
    """Whether depth images have another size than the colour images and the same shape, up to a pixel."""
    across, along = size[0] * camera.height, size[1] * camera.width
    return size != (camera.width, camera.height) and abs(across - along) < max(camera.width, camera.height)


def _float_scale(frames: list[Frame], stated: float | None) -> tuple[float, tuple[str, ...]]:
    """Return the units per metre of float depth images: the stated scale if it makes sense, else metres, else
    millimetres, and how that was read. Raises `InvalidScanError` for values that are none of these."""
    step = max(1, len(frames) // OPTIONS.depth_images_sampled)
    values = [read_depth(f.depth.read_bytes(), f.depth.name).ravel() for f in frames[::step]]
    all_values = np.concatenate(values).astype(np.float64)
    valid = all_values[np.isfinite(all_values) & (all_values > 0)]
    median = float(np.median(valid)) if len(valid) else 1.0
    for scale in ([stated] if stated else []) + [1.0, MILLIMETRES_PER_M]:
        if OPTIONS.min_median_depth_m <= median / scale <= OPTIONS.max_median_depth_m:
            unit = {1.0: "metres", MILLIMETRES_PER_M: "millimetres"}.get(scale, f"{scale:g} per metre")
            return scale, () if scale == stated else (f"The depth images hold floats, read as {unit}.",)
    raise InvalidScanError(
        f"{frames[0].depth.name} holds floats whose median is {median:.3g}: neither metres nor millimetres. Give "
        "depth_scale, their units per metre."
    )


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
