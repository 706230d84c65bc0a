"""`roomfix push-frames`: sends the newest frame of a monitoring camera to the server every few seconds."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import httpx
import typer

from app.commands.backoff import Backoff
from app.commands.console import console, errors
from app.commands.live_capture import LiveCapture
from app.errors import InvalidInputError
from app.limits import limit
from app.vision.image_files.formats import FORMATS_IN_WORDS, PICTURE_SUFFIXES

# Status codes of answers that stay the same however often the frame is sent.
LASTING = {400, 401, 403, 404, 413, 415, 422}


@dataclass(frozen=True, slots=True, kw_only=True)
class PushOptions:
    """How long a server may take."""

    timeout_s: float = limit(
        20.0,
        "Time that the server has for an answer.",
        chosen="By hand: it answers in a second or two, longer when its queue is full.",
    )


OPTIONS = PushOptions()


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
    with httpx.Client(base_url=server, headers=headers, timeout=OPTIONS.timeout_s) as client:
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
    """Post one frame until the server accepts it; raises `InvalidInputError` when it refuses for good.

    After a failure the frame that `newer` returns is sent, if any, since an old frame is of no use.
    """
    backoff = Backoff()
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
        pause_s = backoff.next_pause_s()
        errors.print(f"{problem}; trying again in {pause_s:.0f} s")
        time.sleep(pause_s)
        frame = newer() or frame


def open_frames(source: str, quality: int = 92) -> Iterator[bytes]:
    """Return the frames of a source as image files: one picture repeatedly, the pictures of a folder in turn, or
    the newest picture of a camera.

    Raises `InvalidInputError` for a source that can't be opened.
    """
    path = Path(source)
    if path.is_dir():
        pictures = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in PICTURE_SUFFIXES)
        if not pictures:
            raise InvalidInputError(f"{source} holds no pictures: {FORMATS_IN_WORDS}.")
        return (picture.read_bytes() for picture in pictures)
    if path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES:
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
