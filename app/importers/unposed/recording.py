"""`recording`: frames that a web page filmed, as JPEG files beside `recording.json` with their times and downs."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO
from zipfile import ZIP_STORED, ZipFile, ZipInfo

from app.errors import InvalidScanError

LIST_NAME = "recording.json"
FRAMES_FOLDER = "frames"
Down = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFrame:
    """A frame: its file below the recording's folder, its time, and down in the camera's axes where that is known."""

    name: str
    time_s: float
    down: Down | None


def frame_name(number: int) -> str:
    """Return the name of a frame's file below the folder of frames."""
    return f"{number:06d}.jpg"


class RecordingWriter:
    """Writes a recording's archive frame by frame; the same frames always become the same bytes."""

    def __init__(self, file: BinaryIO) -> None:
        self._archive = ZipFile(file, "w", ZIP_STORED)
        self._frames: list[dict[str, Any]] = []

    def add(self, number: int, picture: bytes, time_s: float, down: Down | None) -> None:
        """Write the next frame, a JPEG."""
        name = frame_name(number)
        self._archive.writestr(ZipInfo(f"{FRAMES_FOLDER}/{name}"), picture)
        self._frames.append({"file": name, "time_s": time_s, "down": down})

    def close(self) -> None:
        """Write the list of the frames, and end the archive."""
        self._archive.writestr(ZipInfo(LIST_NAME), json.dumps({"frames": self._frames}))
        self._archive.close()


def is_recording(names: Sequence[PurePosixPath]) -> bool:
    """Whether paths are those of a recording."""
    return any(
        path.name == LIST_NAME
        and any(other.parent == path.parent / FRAMES_FOLDER for other in names if other.suffix == ".jpg")
        for path in names
    )


def read_recording(directory: Path) -> tuple[Path, tuple[RecordedFrame, ...]]:
    """Return the folder of the frames, and the frames in the order of their times; raises `InvalidScanError`."""
    lists = sorted(path for path in directory.rglob(LIST_NAME) if path.is_file() and not path.is_symlink())
    if len(lists) != 1:
        raise InvalidScanError(f"A recording holds one {LIST_NAME}; there are {len(lists)}.")
    try:
        listed = json.loads(lists[0].read_text(encoding="utf-8"))["frames"]
        frames = [_frame(item) for item in listed]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InvalidScanError(
            f"{LIST_NAME} must be {{frames: [{{file, time_s, down: [x, y, z] or null}}, ...]}}."
        ) from None
    folder = lists[0].parent / FRAMES_FOLDER
    missing = [frame.name for frame in frames if not (folder / frame.name).is_file()]
    if missing:
        raise InvalidScanError(f"{LIST_NAME} lists {missing[0]}, which is not in {FRAMES_FOLDER}.")
    return folder, tuple(sorted(frames, key=lambda frame: frame.time_s))


def _frame(item: dict[str, Any]) -> RecordedFrame:
    name, time_s, down = item["file"], float(item["time_s"]), item.get("down")
    if not isinstance(name, str) or PurePosixPath(name).name != name or not math.isfinite(time_s):
        raise ValueError
    if down is None:
        return RecordedFrame(name=name, time_s=time_s, down=None)
    x, y, z = (float(value) for value in down)
    length = math.hypot(x, y, z)
    if not (math.isfinite(length) and length > 0):
        raise ValueError
    return RecordedFrame(name=name, time_s=time_s, down=(x / length, y / length, z / length))
