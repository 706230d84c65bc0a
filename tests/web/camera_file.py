"""A walk as a file that Chromium plays as its camera."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

FLAGS = ("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream")
# What a browser notes by itself while a server is away.
CUT_ERRORS = (
    *("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY", "ERR_INTERNET_DISCONNECTED"),
    *("WebSocket connection", "401"),
)


def write_walk(path: Path, pictures: Iterable[NDArray[np.uint8]], width: int, height: int, fps: int) -> Path:
    """Write RGB pictures as YUV4MPEG2; Chromium starts it again when it is over."""
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{width} H{height} F{fps}:1 C420jpeg\n".encode())
        for rgb in pictures:
            file.write(b"FRAME\n" + cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420).tobytes())
    return path


def flags_for(path: Path) -> tuple[str, ...]:
    """Return the flags of a browser whose camera plays the file."""
    return (*FLAGS, f"--use-file-for-fake-video-capture={path}")
