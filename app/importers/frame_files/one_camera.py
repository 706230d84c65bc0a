"""Pictures of several cameras, or of one whose focal length changes, resampled as if one camera had taken them all.

A camera that only zooms or has another lens sees along the same rays from the same place: each pixel of the common
camera is looked up where its ray meets the picture's own camera. Depth along the optical axis stays as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError
from app.geometry.camera import REFERENCE_FOCAL_PX, Camera
from app.geometry.camera_hint import CameraHint, hint_of
from app.importers.assembly import Discarded, ScanSource, assemble_scan
from app.importers.frames import Frame, Scan, ScanOptions, is_of_low_confidence
from app.importers.images.color_files import color_size
from app.importers.images.depth_files import read_depth, read_depth_header
from app.importers.scan_camera import camera_stated_in
from app.importers.unpacked import FrameFiles
from app.limits import limit
from app.vision.image_files.formats import DAMAGE, open_image


@dataclass(frozen=True, slots=True, kw_only=True)
class OneCameraOptions:
    """When pictures of several cameras become those of one."""

    tolerance_px: float = limit(
        0.3,
        "A picture whose own camera sees the same rays within this many pixels, at 525 px of focal length, is left.",
        chosen="By hand: below the noise of a feature's place.",
    )
    max_focal_ratio: float = limit(
        1.4,
        "Focal lengths, in image widths, may differ from that of the common camera by this factor.",
        chosen="By hand: autofocus and separate calibrations differ by a few per cent, two lenses of a phone by 2.",
    )
    grid_step_px: int = limit(
        8,
        "Rays are traced at every so many pixels, and interpolated between.",
        chosen="By hand: a lens changes them by less than 0.01 pixels from its tangent over that distance.",
    )


OPTIONS = OneCameraOptions()


@dataclass(frozen=True, slots=True)
class SeenByOne:
    """The camera of a scan, its frames as that camera would have taken them, and sentences on how that was made."""

    camera: CameraHint
    frames: list[Frame]
    notes: tuple[str, ...] = ()


def assemble_of_cameras(
    frames: Sequence[Frame],
    cameras: Sequence[Camera | None],
    discarded: Discarded,
    source: ScanSource,
    options: ScanOptions,
    *,
    files: FrameFiles,
) -> Scan:
    """Return the scan of candidate frames whose pictures have the given cameras, one each.

    `source` states all but the camera; `files` are kept with the scan. Arguments and errors are those of
    `in_one_camera` and `assemble_scan`.
    """
    seen = in_one_camera(
        frames,
        cameras,
        options.camera,
        files,
        has_depth=source.has_depth,
        confidence=source.confidence,
    )
    notes = (*source.notes, *seen.notes)
    own = replace(source, camera=seen.camera, notes=notes, keeps=files)
    return assemble_scan(seen.frames, discarded, own, options)


def in_one_camera(
    frames: Sequence[Frame],
    cameras: Sequence[Camera | None],
    given: CameraHint | None,
    files: FrameFiles,
    *,
    has_depth: bool = True,
    confidence: Mapping[Path, Path] | None = None,
) -> SeenByOne:
    """Return frames whose pictures have the given cameras, one each, as frames of one camera.

    None stands for the camera of a picture that can't be read: its frame stays as it is, to be left out later.
    The common camera is the one with the median focal length among those of the most frequent size. A camera of the
    options, `given`, is that of all pictures as they are. Without `has_depth` depth is left as it is;
    `confidence` are the images of the depth images' confidence. Raises `InvalidScanError` that names the first picture
    whose camera has another kind of lens, or was held the other way.
    """
    known = [camera for camera in cameras if camera is not None]
    if given is not None or not known:
        # Where no picture is left, that and why is said where a scan is put together.
        return SeenByOne(given or CameraHint(), list(frames))
    camera = _common(known)
    changed: list[Frame] = []
    count = 0
    for number, (frame, own) in enumerate(zip(frames, cameras, strict=True)):
        if own is None or _is_near(own, camera) or color_size(frame.color) != (own.width, own.height):
            # A picture of another size than its camera's, or one that can't be read, is refused where all are checked.
            changed.append(frame)
            continue
        _check_similar(frame.name, own, camera)
        depth = _depth(frame, own, camera, files, confidence or {}, number) if has_depth else frame.depth
        color = _color(frame.color, own, camera, files, number)
        changed.append(replace(frame, color=color, depth=depth))
        count += 1
    note = (
        f"The pictures state more than one camera: {count} of {len(frames)} were resampled to the one with the median "
        "focal length."
    )
    return SeenByOne(hint_of(camera), changed, (note,) if count else ())


def _common(cameras: Sequence[Camera]) -> Camera:
    size = Counter((camera.width, camera.height) for camera in cameras).most_common(1)[0][0]
    fitting = sorted(
        (camera for camera in cameras if (camera.width, camera.height) == size), key=lambda c: c.params[0]
    )
    return fitting[len(fitting) // 2]


def _is_near(own: Camera, camera: Camera) -> bool:
    """Whether two cameras of one size see the same rays at the same pixels."""
    if (own.width, own.height) != (camera.width, camera.height):
        return False
    if own == camera:
        return True
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 5), np.linspace(0, camera.height - 1, 5))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    tolerance_px = OPTIONS.tolerance_px * camera.params[0] / REFERENCE_FOCAL_PX
    return bool(np.abs(_of_own(pixels, own, camera) - pixels).max() <= tolerance_px)


def _of_own(pixels: NDArray[np.float64], own: Camera, camera: Camera) -> NDArray[np.float64]:
    """Return where the pixels (n, 2) of the common camera are in a picture's own; far outside for what it can't see."""
    rays = camera.normalize(pixels)
    return np.nan_to_num(own.project(np.hstack([rays, np.ones((len(rays), 1))])), nan=-1e6)


def _check_similar(name: str, own: Camera, camera: Camera) -> None:
    ratio = (own.params[0] / own.width) / (camera.params[0] / camera.width)
    turned = (own.width > own.height) != (camera.width > camera.height)
    if turned or not 1 / OPTIONS.max_focal_ratio <= ratio <= OPTIONS.max_focal_ratio:
        raise InvalidScanError(
            f"{name} has another focal length or was held the other way than most frames: send frames of one lens, "
            "without zoom, all upright or all sideways."
        )


def _color(path: Path, own: Camera, camera: Camera, files: FrameFiles, number: int) -> Path:
    try:
        with path.open("rb") as file, open_image(file) as image:
            bgr = np.asarray(image.convert("RGB"), dtype=np.uint8)[..., ::-1]
    except DAMAGE:
        # Left out where all files are checked.
        return path
    seen = _seen(np.ascontiguousarray(bgr), own, camera, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
    return files.write_picture(f"one_camera/{number:06d}.jpg", np.asarray(seen, dtype=np.uint8))


def _depth(
    frame: Frame,
    own: Camera,
    camera: Camera,
    files: FrameFiles,
    confidence: Mapping[Path, Path],
    number: int,
) -> Path:
    """Write a frame's depth image as the common camera sees it, without what has low confidence."""
    header = read_depth_header(frame.depth)
    if header is None:
        return frame.depth
    raw = read_depth(frame.depth.read_bytes(), frame.depth.name)
    values: NDArray[Any] = raw.astype(np.float32 if raw.dtype.kind == "f" else np.uint16)
    if frame.depth in confidence:
        values[is_of_low_confidence(confidence[frame.depth], raw.shape)] = 0
    size = round(camera.width * header.width / own.width), round(camera.height * header.height / own.height)
    with camera_stated_in(frame.depth.name):
        smaller = own.scaled_to(header.width, header.height), camera.scaled_to(*size)
    moved = _seen(values, *smaller, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)
    name = f"one_camera/{number:06d}"
    if raw.dtype.kind == "f":
        return files.write_array(f"{name}.npy", np.asarray(moved, dtype=np.float32))
    return files.write_depth(f"{name}.png", np.asarray(moved, dtype=np.uint16))


def _seen(image: NDArray[Any], own: Camera, camera: Camera, interpolation: int, border: int) -> NDArray[Any]:
    """Return an image (height, width[, channels]) as the common camera sees it; 0 outside with a constant border."""
    if own.is_distorted or camera.is_distorted:
        return np.asarray(cv2.remap(image, *_maps(own, camera), interpolation, borderMode=border))
    scale = np.array(own.params[:2]) / camera.params[:2]
    shift = np.array(own.params[2:4]) - scale * camera.params[2:4]
    own_from_common = np.column_stack([np.diag(scale), shift])
    size = camera.width, camera.height
    flags = interpolation | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, own_from_common, size, flags=flags, borderMode=border))


def _maps(own: Camera, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the columns and rows (height, width) of a picture that the pixels of the common camera are taken from."""
    step = OPTIONS.grid_step_px
    across, along = -(-camera.width // step) + 1, -(-camera.height // step) + 1
    u, v = np.meshgrid(np.arange(across) * float(step), np.arange(along) * float(step))
    places = _of_own(np.stack([u.ravel(), v.ravel()], axis=1), own, camera)
    coarse = places.reshape(along, across, 2).astype(np.float32)
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    fine = cv2.remap(coarse, (x / step).astype(np.float32), (y / step).astype(np.float32), cv2.INTER_LINEAR)
    return np.ascontiguousarray(fine[..., 0]), np.ascontiguousarray(fine[..., 1])
