"""Frames that an importer takes out of a recording: files in a folder that lives as long as the scan."""

from __future__ import annotations

import io
import shutil
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class UnpackedOptions:
    """How pictures of a recording are stored while its map is built."""

    jpeg_quality: int = limit(
        95,
        "JPEG quality of pictures that were not stored as pictures, such as those of a video.",
        chosen="By hand: its noise is far below that of the video's own compression.",
    )


OPTIONS = UnpackedOptions()
WITHOUT_DEPTH = "The scan has no depth images: points are triangulated from the given poses."


class FrameFiles:
    """A folder for the frames of a recording; it is deleted when nothing refers to this object any more."""

    def __init__(self, scratch: Path | None) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="roomfix-frames-", dir=scratch))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)

    def write(self, name: str, data: bytes) -> Path:
        """Write a file below the folder and return its path."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path

    def write_picture(self, name: str, bgr: NDArray[np.uint8]) -> Path:
        """Write a colour picture (height, width, 3) or a grey one as JPEG."""
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality])
        return self.write(name, data.tobytes())

    def write_depth(self, name: str, raw: NDArray[np.uint16]) -> Path:
        """Write a depth image (height, width) of integers as PNG."""
        _, data = cv2.imencode(".png", raw, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return self.write(name, data.tobytes())

    def write_array(self, name: str, values: NDArray[np.float32]) -> Path:
        """Write a depth image (height, width) of floats as a NumPy array."""
        file = io.BytesIO()
        np.save(file, values, allow_pickle=False)
        return self.write(name, file.getvalue())

    def write_depth_m(self, name: str, depth_m: NDArray[np.float32]) -> Path:
        """Write a depth image (height, width) in metres, in millimetres; what is not finite or too far becomes 0."""
        raw = np.nan_to_num(1000.0 * depth_m.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
        raw[(raw < 0) | (raw >= np.iinfo(np.uint16).max)] = 0
        return self.write_depth(name, raw.round().astype(np.uint16))

    def blank_depth(self, width: int, height: int) -> Path:
        """Return a depth image without any depth, for frames that have none."""
        path = self.path / f"blank-{width}x{height}.png"
        return path if path.is_file() else self.write_depth(path.name, np.zeros((height, width), np.uint16))
