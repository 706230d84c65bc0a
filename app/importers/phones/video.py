"""The pictures of a video, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.errors import InvalidScanError


@dataclass(frozen=True, slots=True)
class Video:
    """What a video's header says: size in pixels, pictures a second (0 if it doesn't say) and how many there are."""

    path: Path
    width: int
    height: int
    fps: float
    count: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    def pictures(self, *, upright: bool = False) -> Iterator[NDArray[np.uint8]]:
        """Yield the pictures (height, width, 3), BGR, as they are stored, or turned `upright` as players show them."""
        capture = _opened(self.path)
        if upright:
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        try:
            while capture.grab():
                read, picture = capture.retrieve()
                if not read:
                    return
                yield np.asarray(picture, dtype=np.uint8)
        finally:
            capture.release()


def open_video(path: Path) -> Video:
    """Return a video's header; raises `InvalidScanError` for a file that is not a video or can't be decoded."""
    capture = _opened(path)
    try:
        values = [
            capture.get(key)
            for key in (
                cv2.CAP_PROP_FRAME_WIDTH,
                cv2.CAP_PROP_FRAME_HEIGHT,
                cv2.CAP_PROP_FPS,
                cv2.CAP_PROP_FRAME_COUNT,
            )
        ]
    finally:
        capture.release()
    width, height, fps, count = (value if np.isfinite(value) else 0.0 for value in values)
    if width < 1 or height < 1:
        raise InvalidScanError(f"{path.name} holds no pictures.")
    return Video(path, int(width), int(height), float(fps), max(int(count), 0))


def _opened(path: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InvalidScanError(f"{path.name} is not a video that can be decoded: it is damaged or cut short.")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture
