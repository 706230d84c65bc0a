"""Draws a plan file as a PNG that can be shown, in a process of its own."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from app import errors
from app.errors import InvalidImageError
from app.importers.plan_images.order import Drawn, DrawOrder
from app.storage.blobs import BlobStore

COMMAND = (sys.executable, "-m", "app.importers.plan_images")
ROOT = Path(__file__).resolve().parents[3]
FAILED = "The plan can't be drawn: it is damaged, or needs too much memory or time. Send a simpler file or a lower dpi."


@dataclass(frozen=True, slots=True)
class DrawnPlan:
    """What came of a plan file: the picture, None where it is the file itself, and the blob of its tiles if it has."""

    picture: bytes | None
    drawn: Drawn
    tiles_blob: str | None = None


def draw_plan(data: bytes, order: DrawOrder, scratch_dir: Path, blobs: BlobStore | None = None) -> DrawnPlan:
    """Draw a plan file as PNG, its tiles into `blobs` if the order has them; raises `InvalidImageError`,
    `ImageTooLargeError`, `InvalidInputError`.

    One plan is drawn at a time, whichever process asks, since a large one takes gigabytes while it is drawn.
    """
    scratch_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch_dir, prefix="plan-") as folder, _one_at_a_time(scratch_dir):
        source, picture, tiles = (
            Path(folder).resolve() / name for name in ("source", "plan.png", "plan.tiles")
        )
        source.write_bytes(data)
        try:
            ended = subprocess.run(  # noqa: S603 - our own module
                (*COMMAND, str(source), str(picture), str(tiles)),
                input=json.dumps(asdict(order)).encode(),
                capture_output=True,
                check=False,
                timeout=order.timeout_s,
                cwd=ROOT,
            )
        except subprocess.TimeoutExpired:
            raise InvalidImageError(FAILED) from None
        if ended.returncode != 0:
            raise InvalidImageError(FAILED)
        answer = json.loads(ended.stdout)
        if "error" in answer:
            raise getattr(errors, answer["error"])(answer["message"])
        origin = answer.pop("origin_px")
        drawn = Drawn(**answer, origin_px=None if origin is None else (origin[0], origin[1]))
        return DrawnPlan(
            picture.read_bytes() if picture.exists() else None,
            drawn,
            blobs.put_file(tiles) if blobs is not None and drawn.has_tiles else None,
        )


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which needs no file."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
