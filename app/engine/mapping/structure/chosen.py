"""The pictures that are reconstructed: chosen, upright, of one size, and what is known of their camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.frame_images import frame_rgb
from app.engine.mapping.structure.motion import MotionMeter, choose_frames
from app.engine.progress import Progress
from app.engine.query.camera_sources import camera_from_tags
from app.errors import InvalidCameraError, InvalidImageError, InvalidScanError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint
from app.geometry.depth import DepthImage
from app.geometry.focal import pinhole
from app.geometry.se3 import Pose
from app.importers.frames import DepthFormat, Frame, Scan
from app.importers.phones.video import Video, open_video
from app.importers.unpacked import FrameFiles
from app.importers.unposed.scan import UnposedScan
from app.limits import limit
from app.vision.exif import read_photo_tags
from app.vision.images import Rgb, decode_image, measure_quality, to_gray

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOptions:
    """How pictures are prepared."""

    max_side_px: int = limit(
        1280,
        "Pictures are reduced to this longer side.",
        chosen="By hand: features are found at 960 pixels; photos of 12 megapixels would take ten times the space.",
    )
    default_focal_ratio: float = limit(
        0.85,
        "Focal length over the longer side from which a camera that nothing is known of is calibrated.",
        chosen="By hand: phones' main cameras film with 0.7 to 1.0.",
    )
    default_fps: float = limit(
        30.0, "Frames a second of a video that does not say it.", chosen="By hand: the usual rate."
    )


OPTIONS = PictureOptions()
STILL = Pose.identity()


# Why photos are left out, as a sentence says it.
IN_WORDS = {
    "unreadable_file": "damaged or no pictures at all",
    "poor_image": "black, white or without contrast",
    "other_size": "of another size than most",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenPictures:
    """A scan of the chosen frames, whose poses mean nothing yet.

    `camera_source` is `given`, `exif` or `guess`; a guess is only where the calibration starts. `total` is the number
    of frames that were there, `original_size` their width and height as they were sent. `is_sequence` says that frames
    beside each other were taken one after the other.
    """

    scan: Scan
    camera_source: str
    total: int
    is_sequence: bool
    original_size: tuple[int, int]

    def depth_of(self, row: int) -> DepthImage:
        """Return the depth image (height, width) in metres of a picture."""
        return self.scan.depth_m(self.scan.frames[row])


def choose_pictures(
    unposed: UnposedScan,
    wanted: Collection[str],
    min_frames: int,
    progress: Progress,
    *,
    most: int | None = None,
) -> ChosenPictures:
    """Return the pictures that are reconstructed; `wanted` are names of photos and frames, or seconds of a video, that
    have to be among them.

    With `most` only so many pictures from the first on are looked at. Raises `InvalidScanError` for a video that ends
    before its first picture, and for fewer than `min_frames` pictures, unless there may be more after `most`.
    """
    if unposed.video is not None:
        chosen = _of_video(unposed, open_video(unposed.video), wanted, most, progress)
    elif unposed.listed is not None:
        looked_at = replace(unposed.listed, frames=unposed.listed.frames[:most])
        chosen = _of_listed(looked_at, wanted, progress)
    else:
        chosen = _of_photos(replace(unposed, photos=unposed.photos[:most]), progress)
    if len(chosen.scan.frames) < min_frames and chosen.total != most:
        raise InvalidScanError(_too_few(chosen, min_frames))
    return chosen


def _too_few(chosen: ChosenPictures, min_frames: int) -> str:
    """Return the sentence on too few pictures, which names what was left out for another reason than its view."""
    count, left_out = len(chosen.scan.frames), chosen.scan.discarded
    if not left_out:
        return (
            f"Of {chosen.total} pictures {count} differ enough from each other to be used, and a map needs "
            f"{min_frames}: walk through the place while filming, or take more photos."
        )
    reasons = ", ".join(
        f"{len(names)} {IN_WORDS.get(reason, reason)}, {names[0]} first" for reason, names in left_out.items()
    )
    return (
        f"Of {chosen.total} pictures {count} can be used, and a map needs {min_frames}; left out are {reasons}: send "
        "these anew, or take more photos."
    )


def frame_time_s(name: str) -> float | None:
    """Return the seconds that a name stands for, None for a name that is no number."""
    try:
        return float(name)
    except ValueError:
        return None


def _of_video(
    unposed: UnposedScan, video: Video, wanted: Collection[str], most: int | None, progress: Progress
) -> ChosenPictures:
    meter = MotionMeter.start()
    for picture in _counted(
        islice(video.pictures(upright=True), most), video.count, "measure_frames", progress
    ):
        meter.add(_gray(picture))
    total = len(meter.steps)
    if not total:
        raise InvalidScanError(
            f"{video.path.name} holds no picture that can be decoded: it is damaged or cut short."
        )
    fps = video.fps or OPTIONS.default_fps
    times_s = [time for name in wanted if (time := frame_time_s(name)) is not None]
    forced = {min(total - 1, max(0, round(time_s * fps))) for time_s in times_s}
    numbers = set(choose_frames(meter.steps, meter.sharpness, forced))
    files, frames, size = FrameFiles(unposed.scratch), [], (0, 0)
    for number, picture in enumerate(
        _counted(islice(video.pictures(upright=True), total), total, "choose_frames", progress)
    ):
        if number in numbers:
            small = _reduced(picture)
            size = small.shape[1], small.shape[0]
            color = files.write_picture(f"rgb/{number:06d}.jpg", small)
            frames.append(
                _frame(f"{video.path.name}/{number:06d}", number / fps, color, files.blank_depth(*size))
            )
    original = picture.shape[1], picture.shape[0]
    camera = _given_camera(unposed.camera, original, size)
    notes = f"Of {total} pictures of {video.path.name}, {len(frames)} were chosen by motion and sharpness."
    scan = _scan(camera or _default_camera(*size), frames, files, (notes,))
    return ChosenPictures(
        scan=scan,
        camera_source="guess" if camera is None else "given",
        total=total,
        is_sequence=True,
        original_size=original,
    )


def _of_listed(listed: Scan, wanted: Collection[str], progress: Progress) -> ChosenPictures:
    meter = MotionMeter.start()
    for frame in _counted(listed.frames, len(listed.frames), "measure_frames", progress):
        meter.add(to_gray(frame_rgb(listed, frame)))
    taken_s = np.array([frame.timestamp_s for frame in listed.frames])
    times_s = [time for name in wanted if (time := frame_time_s(name)) is not None]
    forced = {number for number, frame in enumerate(listed.frames) if frame.name in wanted}
    forced |= {int(np.abs(taken_s - time_s).argmin()) for time_s in times_s}
    numbers = choose_frames(meter.steps, meter.sharpness, forced)
    frames = tuple(replace(listed.frames[number], scan_from_camera=STILL) for number in numbers)
    note = f"Of {len(listed.frames)} frames, {len(frames)} were chosen by motion and sharpness."
    scan = replace(listed, frames=frames, notes=(*listed.notes, note))
    return ChosenPictures(
        scan=scan,
        camera_source="given",
        total=len(listed.frames),
        is_sequence=True,
        original_size=(listed.camera.width, listed.camera.height),
    )


def _of_photos(unposed: UnposedScan, progress: Progress) -> ChosenPictures:
    files = FrameFiles(unposed.scratch)
    frames: list[tuple[Frame, tuple[int, int], tuple[int, int]]] = []
    times_s = {frame.name: frame.time_s for frame in unposed.recorded}
    discarded: dict[str, list[str]] = {}
    left_out: list[Frame] = []
    for number, path in enumerate(_counted(unposed.photos, len(unposed.photos), "choose_frames", progress)):
        rgb = _photo(path)
        if rgb is None or measure_quality(to_gray(rgb)).is_poor:
            discarded.setdefault("unreadable_file" if rgb is None else "poor_image", []).append(path.name)
            left_out.append(_frame(path.name, times_s.get(path.name, float(number)), path, path))
            continue
        small = _reduced(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR).astype(np.uint8))
        size = small.shape[1], small.shape[0]
        color = files.write_picture(f"rgb/{number:06d}.jpg", small)
        frame = _frame(path.name, times_s.get(path.name, float(number)), color, files.blank_depth(*size))
        frames.append((frame, size, (rgb.shape[1], rgb.shape[0])))
    if not frames:
        raise InvalidScanError(
            f"None of the {len(unposed.photos)} photos can be used: {_counts(discarded)}, "
            f"{unposed.photos[0].name} first."
        )
    (size, original), _ = Counter((size, original) for _, size, original in frames).most_common(1)[0]
    kept = [frame for frame, own, _ in frames if own == size]
    others = [frame for frame, own, _ in frames if own != size]
    if others:
        discarded["other_size"] = [frame.name for frame in others]
    given = _given_camera(unposed.camera, original, size)
    tagged = (
        None if given is not None else _tagged_camera(unposed.photos, {frame.name for frame in kept}, size)
    )
    source = "given" if given else "exif" if tagged else "guess"
    scan = _scan(given or tagged or _default_camera(*size), kept, files, (), discarded)
    return ChosenPictures(
        scan=replace(scan, left_out=(*left_out, *others), has_times=bool(unposed.recorded)),
        camera_source=source,
        total=len(unposed.photos),
        is_sequence=bool(unposed.recorded),
        original_size=original,
    )


def _counts(discarded: dict[str, list[str]]) -> str:
    return ", ".join(f"{len(names)} {reason}" for reason, names in discarded.items())


def _photo(path: Path) -> Rgb | None:
    try:
        return decode_image(path.read_bytes())
    except (InvalidImageError, OSError):
        return None


def _counted(items: Iterable[Item], total: int, stage: str, progress: Progress) -> Iterator[Item]:
    """Yield items and report their number; what a video says of its length may be wrong."""
    for done, item in enumerate(items):
        progress.report(stage, done, max(total, done + 1))
        yield item


def _frame(name: str, time_s: float, color: Path, depth: Path) -> Frame:
    return Frame(name, time_s, color, depth, STILL)


def _gray(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _reduced(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = OPTIONS.max_side_px / max(bgr.shape[:2])
    if scale >= 1:
        return bgr
    size = round(scale * bgr.shape[1]), round(scale * bgr.shape[0])
    return np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _scan(
    camera: Camera,
    frames: list[Frame],
    files: FrameFiles,
    notes: tuple[str, ...],
    discarded: dict[str, list[str]] | None = None,
) -> Scan:
    return Scan(
        camera=camera,
        frames=tuple(frames),
        discarded={reason: tuple(names) for reason, names in (discarded or {}).items()},
        depth=DepthFormat(scale=1000.0),
        notes=notes,
        has_depth=False,
        keeps=files,
    )


def _given_camera(
    given: CameraHint | None, original: tuple[int, int], size: tuple[int, int]
) -> Camera | None:
    """Return the camera of the options for pictures reduced from `original` to `size`."""
    if given is None:
        return None
    try:
        camera = given.camera or Camera.from_values(given.values, *original)
        return camera.scaled_to(*size)
    except InvalidCameraError as error:
        raise InvalidScanError(f"camera: {error}") from None


def _tagged_camera(photos: Iterable[Path], kept: set[str], size: tuple[int, int]) -> Camera | None:
    for path in photos:
        if path.name in kept:
            likely = camera_from_tags(read_photo_tags(path.read_bytes()), *size).likely
            if likely is not None:
                return likely
    return None


def _default_camera(width: int, height: int) -> Camera:
    return pinhole(width, height, OPTIONS.default_focal_ratio * max(width, height))
