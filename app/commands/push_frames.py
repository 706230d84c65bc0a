"""`roomfix push-frames`: the process beside a monitoring camera that sends its newest frame every few seconds."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import cv2
import httpx
import typer

from app.commands.console import console, errors
from app.commands.live_capture import LiveCapture
from app.errors import InvalidInputError

PICTURES = {".jpg", ".jpeg", ".png", ".webp"}
FIRST_WAIT_S, MAX_WAIT_S = 1.0, 60.0
TIMEOUT_S = 20.0
# What the server will refuse again, however often it is asked.
LASTING = {400, 401, 403, 404, 413, 415, 422}


def push_frames(
    source: Annotated[
        str,
        typer.Option(
            help="A picture, a folder of pictures, the URL of an RTSP or MJPEG stream, a device number."
        ),
    ],
    anchor: Annotated[str, typer.Option(help="The anchor's id.")],
    server: Annotated[
        str, typer.Option(help="The server, e.g. http://127.0.0.1:8000.")
    ] = "http://127.0.0.1:8000",
    key_env: Annotated[
        str, typer.Option(help="Environment variable that holds the key.")
    ] = "ROOMFIX_ANCHOR_KEY",
    every: Annotated[float, typer.Option(min=0.1, help="Seconds between frames.")] = 5.0,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")] = None,
    quality: Annotated[int, typer.Option(min=50, max=100, help="JPEG quality of camera frames.")] = 92,
) -> None:
    """Push a camera's frames to its anchor until interrupted; after a failure wait longer each time, up to a minute."""
    key = os.environ.get(key_env)
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    frames = open_frames(source, quality)
    with httpx.Client(base_url=server, headers=headers, timeout=TIMEOUT_S) as client:
        sent = 0
        while count is None or sent < count:
            started = time.monotonic()
            frame = next(frames, None)
            if frame is None:
                break
            send(client, anchor, frame, lambda: next(frames, None))
            sent += 1
            if count is None or sent < count:
                time.sleep(max(0.0, every - (time.monotonic() - started)))


def send(client: httpx.Client, anchor: str, frame: bytes, newer: Callable[[], bytes | None]) -> None:
    """Post one frame, again and again until the server takes it; raises `InvalidInputError` when it never will.

    What is sent after a failure is the frame that `newer` gives, if any: an old one is of no use.
    """
    wait_s = FIRST_WAIT_S
    while True:
        try:
            answer = client.post(f"/anchors/{anchor}/frames", files={"image": ("frame.jpg", frame)})
        except httpx.TransportError as error:
            problem = f"the server can't be reached ({type(error).__name__})"
        else:
            if answer.is_success:
                body = answer.json()
                console.print(
                    f"{body['received_at']} {body['features']} features, POIs {body['pois_visible']}"
                )
                return
            problem = _detail(answer)
            if answer.status_code in LASTING:
                raise InvalidInputError(problem)
        # A random part keeps many cameras from coming back at the same moment.
        pause = wait_s * random.uniform(0.7, 1.3)
        errors.print(f"{problem}; trying again in {pause:.0f} s")
        time.sleep(pause)
        wait_s = min(2.0 * wait_s, MAX_WAIT_S)
        frame = newer() or frame


def open_frames(source: str, quality: int = 92) -> Iterator[bytes]:
    """Return the frames of a source as image files: one picture again and again, a folder's in turn, or a camera's.

    Of a camera each is the newest one. Raises `InvalidInputError` for a source that can't be opened.
    """
    path = Path(source)
    if path.is_dir():
        pictures = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in PICTURES)
        if not pictures:
            raise InvalidInputError(f"{source} holds no JPEG, PNG or WebP pictures.")
        return (picture.read_bytes() for picture in pictures)
    if path.is_file() and path.suffix.lower() in PICTURES:
        return _again(path)
    return _captured(source, quality)


def _again(path: Path) -> Iterator[bytes]:
    while True:
        yield path.read_bytes()


def _captured(source: str, quality: int) -> Iterator[bytes]:
    capture = LiveCapture(source)

    def frames() -> Iterator[bytes]:
        try:
            while True:
                encoded, data = cv2.imencode(".jpg", capture.take(), [cv2.IMWRITE_JPEG_QUALITY, quality])
                if encoded:
                    yield data.tobytes()
        finally:
            capture.close()

    return frames()


def _detail(answer: httpx.Response) -> str:
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"the server answered {answer.status_code}"
