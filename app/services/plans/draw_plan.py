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
from dataclasses import asdict
from pathlib import Path

from app import errors
from app.errors import InvalidImageError
from app.importers.plan_images.order import Drawn, DrawOrder

COMMAND = (sys.executable, "-m", "app.importers.plan_images")
ROOT = Path(__file__).resolve().parents[3]
FAILED = "The plan can't be drawn: it is damaged, or needs too much memory or time. Send a simpler file or a lower dpi."


def draw_plan(data: bytes, order: DrawOrder, scratch_dir: Path) -> tuple[bytes, Drawn]:
    """Return the PNG of a plan file; raises `InvalidImageError`, `ImageTooLargeError`, `InvalidInputError`.

    One plan is drawn at a time, whichever process asks, since a large one takes gigabytes while it is drawn.
    """
    scratch_dir.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch_dir, prefix="plan-") as folder, _one_at_a_time(scratch_dir):
        source, target = Path(folder).resolve() / "source", Path(folder).resolve() / "plan.png"
        source.write_bytes(data)
        try:
            ended = subprocess.run(  # noqa: S603 - our own module
                (*COMMAND, str(source), str(target)),
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
        return target.read_bytes(), Drawn(
            **answer, origin_px=None if origin is None else (origin[0], origin[1])
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
