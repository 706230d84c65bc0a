"""Small pictures of the frames that a build left out, a few for each reason, for its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from app.errors import InvalidScanError, RoomfixError
from app.importers.frames import Frame, Scan
from app.importers.scan_files import resolve_inside
from app.limits import limit
from app.vision.faces.blur import with_blurred_faces
from app.vision.faces.detector import FaceDetector
from app.vision.images import decode_image, shrink


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutOptions:
    """How many pictures of frames that were left out are kept, and how small they are."""

    pictures: int = limit(
        6,
        "Pictures that are kept for each reason, evenly chosen.",
        chosen="By hand: enough to see what the frames have in common.",
    )
    side_px: int = limit(
        240,
        "Their longer side.",
        chosen="By hand: shown 160 pixels wide, on screens of 1.5 pixels each; blur can still be seen.",
    )
    jpeg_quality: int = limit(
        75, "Their JPEG quality.", chosen="By hand: about 10 kB each, and 40 kB for pure noise."
    )


OPTIONS = LeftOutOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutFrame:
    """A frame that was left out: why, its name, its time since the scan's first frame if known, a JPEG of it."""

    reason: str
    name: str
    time_s: float | None
    jpeg: bytes


def left_out_frames(
    scan: Scan, discarded: Mapping[str, Sequence[str]], faces: FaceDetector | None
) -> Iterator[LeftOutFrame]:
    """Yield frames that were left out, at most `pictures` for each reason; `discarded` has all of them by name.

    Frames without a picture that can be read are passed over. Faces are blurred where there is a detector.
    """
    frames = {frame.name: frame for frame in (*scan.frames, *scan.left_out)}
    folder = _folder_of(scan)
    start_s = min((frame.timestamp_s for frame in frames.values()), default=0.0)
    for reason, names in discarded.items():
        paths = [(name, path) for name in names if (path := _picture_of(name, frames, folder)) is not None]
        for name, path in _evenly(paths):
            jpeg = _small_jpeg(path, faces)
            if jpeg is None:
                continue
            frame = frames.get(name) if scan.has_times else None
            time_s = None if frame is None else round(frame.timestamp_s - start_s, 3)
            yield LeftOutFrame(reason=reason, name=name, time_s=time_s, jpeg=jpeg)


def _folder_of(scan: Scan) -> Path | None:
    """Return the folder that names of frames are paths below; None where they are none, as those of a video are."""
    for frame in scan.frames:
        if frame.color.as_posix().endswith(f"/{frame.name}"):
            return Path(frame.color.as_posix().removesuffix(frame.name))
    return None


def _picture_of(name: str, frames: Mapping[str, Frame], folder: Path | None) -> Path | None:
    """Return the file of a frame's picture, None where there is none inside the scan's folder."""
    if name in frames:
        return frames[name].color
    if folder is None:
        return None
    try:
        path = resolve_inside(folder, name, "left out")
        return path if path.is_file() else None
    except (InvalidScanError, OSError):
        return None


def _evenly(paths: Sequence[tuple[str, Path]]) -> list[tuple[str, Path]]:
    """Return as many as are kept, evenly chosen, the first and the last among them."""
    if len(paths) <= OPTIONS.pictures:
        return list(paths)
    rows = np.linspace(0, len(paths) - 1, OPTIONS.pictures).round().astype(int)
    return [paths[row] for row in rows]


def _small_jpeg(path: Path, faces: FaceDetector | None) -> bytes | None:
    """Return a picture made small, None for a file that can't be read as one."""
    try:
        data = path.read_bytes()
        if faces is not None:
            data = with_blurred_faces(data, faces) or data
        small, _ = shrink(decode_image(data), OPTIONS.side_px)
    except (RoomfixError, OSError):
        return None
    flags = [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality]
    return cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), flags)[1].tobytes()
