"""A client that behaves as a phone does: frames by WebSocket at a fixed rate, and a new connection when one breaks."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import websockets
from websockets.asyncio.client import ClientConnection, connect

from app.errors import InvalidInputError, RoomfixError
from app.limits import limit
from app.vision.image_files.formats import FORMATS_IN_WORDS, PICTURE_SUFFIXES

OnAnswer = Callable[["Answer"], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamOptions:
    """How frames are sent, and how long answers are waited for."""

    jpeg_quality: int = limit(
        90, "JPEG quality of a video's frames.", chosen="By hand: what phones use by default."
    )
    retry_s: float = limit(
        0.2,
        "Pause before a connection that broke is made again.",
        chosen="By hand: two frames at ten a second.",
    )
    give_up_s: float = limit(
        30.0,
        "Time without any answer after which the stream ends.",
        chosen="By hand: a server restarts in less.",
    )
    start_timeout_s: float = limit(
        30.0, "Time that the server has to start a session.", chosen="By hand: a full queue empties in less."
    )
    last_answer_s: float = limit(
        5.0,
        "Time that the answer to the last frame is waited for.",
        chosen="By hand: a slow query takes about 1 s.",
    )
    poll_s: float = limit(
        0.01, "Time between checks for that answer.", chosen="By hand: below the time of any query."
    )


OPTIONS = StreamOptions()


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer: the number of its frame, from 0, its JSON, when the frame was sent and when the answer came."""

    sent: int
    body: dict[str, Any]
    sent_at: float
    received_at: float

    @property
    def latency_ms(self) -> float:
        """Time from sending the frame to receiving its answer."""
        return 1e3 * (self.received_at - self.sent_at)


@dataclass(slots=True)
class StreamLog:
    """What happened: the number of frames sent, the number of the last one, repeated connections, and the answers."""

    sent: int = 0
    last: int = -1
    reconnects: int = 0
    answers: list[Answer] = field(default_factory=list)


def read_frames(source: Path, max_frames: int | None = None) -> list[bytes]:
    """Return the frames of a folder's images, by name, or of a video file as JPEG; at most `max_frames`.

    Raises `InvalidInputError` for a source without frames.
    """
    if source.is_dir():
        files = sorted(path for path in source.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES)[
            :max_frames
        ]
        frames = [path.read_bytes() for path in files]
    else:
        frames = _video_frames(source, max_frames)
    if not frames:
        raise InvalidInputError(f"{source} holds no frames: give a video or a folder of {FORMATS_IN_WORDS}.")
    return frames


def _video_frames(source: Path, max_frames: int | None) -> list[bytes]:
    video = cv2.VideoCapture(str(source))
    frames: list[bytes] = []
    try:
        while max_frames is None or len(frames) < max_frames:
            read, image = video.read()
            if not read:
                break
            frames.append(
                cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, OPTIONS.jpeg_quality])[1].tobytes()
            )
    finally:
        video.release()
    return frames


def start_session(server: str, key: str | None, **fields: Any) -> str:
    """Start a session and return its id; raises `RoomfixError` with the server's sentence."""
    given = {name: value for name, value in fields.items() if value is not None}
    answer = httpx.post(
        f"{server}/sessions", json=given, headers=_headers(key), timeout=OPTIONS.start_timeout_s
    )
    if answer.status_code != 201:
        raise RoomfixError(str(answer.json().get("detail", answer.text)))
    return str(answer.json()["session"])


def _headers(key: str | None) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}"} if key else {}


async def stream_frames(
    server: str,
    session: str,
    frames: Sequence[bytes],
    *,
    fps: float = 10.0,
    key: str | None = None,
    on_answer: OnAnswer | None = None,
    give_up_s: float = OPTIONS.give_up_s,
    is_enough: Callable[[], bool] = lambda: False,
) -> StreamLog:
    """Send frames at a fixed rate, without waiting for answers, and return what happened.

    A connection that breaks is made again, and the session continues with the frame that is due by then, as with a
    camera. Ends before the last frame when `is_enough` returns true. Raises `RoomfixError` when the server refuses, or
    gives no answer for longer than `give_up_s`.
    """
    address = f"{server.replace('http', 'ws', 1)}/sessions/{session}/stream"
    log, started, away_since = StreamLog(), time.perf_counter(), time.perf_counter()
    connected = False
    while True:
        try:
            async with connect(address, additional_headers=_headers(key), max_size=None) as socket:
                log.reconnects += connected
                connected = True
                await _send_and_receive(socket, frames, fps, started, log, on_answer, is_enough)
                return log
        except websockets.InvalidStatus as error:
            body = error.response.body or b""
            raise RoomfixError(
                f"The server refused the stream: {body.decode(errors='replace')[:300]}"
            ) from None
        except (OSError, websockets.WebSocketException):
            newest = log.answers[-1].received_at if log.answers else away_since
            if time.perf_counter() - max(newest, away_since) > give_up_s:
                raise RoomfixError(f"{server} has not answered for {give_up_s:g} s.") from None
            await asyncio.sleep(OPTIONS.retry_s)


async def _send_and_receive(
    socket: ClientConnection,
    frames: Sequence[bytes],
    fps: float,
    started: float,
    log: StreamLog,
    on_answer: OnAnswer | None,
    is_enough: Callable[[], bool],
) -> None:
    on_the_way: dict[int, tuple[int, float]] = {}
    receiving = asyncio.create_task(_receive(socket, on_the_way, log, on_answer))
    try:
        received = 0
        for number in range(_due(started, fps), len(frames)):
            await asyncio.sleep(max(started + number / fps - time.perf_counter(), 0.0))
            if is_enough():
                break
            if number < _due(started, fps) - 1:
                continue
            await socket.send(json.dumps({"timestamp": number / fps}))
            received += 1
            on_the_way[received] = (number, time.perf_counter())
            await socket.send(frames[number])
            log.sent, log.last = log.sent + 1, number
            if receiving.done():
                receiving.result()
        await _wait_for_last(receiving, on_the_way, received)
    finally:
        receiving.cancel()
        await asyncio.gather(receiving, return_exceptions=True)


def _due(started: float, fps: float) -> int:
    """Return the number of the frame that is due now."""
    return int(np.ceil((time.perf_counter() - started) * fps))


async def _wait_for_last(receiving: asyncio.Task[None], on_the_way: dict[int, Any], last: int) -> None:
    until = time.perf_counter() + OPTIONS.last_answer_s
    while last in on_the_way and not receiving.done() and time.perf_counter() < until:
        await asyncio.sleep(OPTIONS.poll_s)


async def _receive(
    socket: ClientConnection,
    on_the_way: dict[int, tuple[int, float]],
    log: StreamLog,
    on_answer: OnAnswer | None,
) -> None:
    async for text in socket:
        body = json.loads(text)
        entry = on_the_way.pop(body.get("received") or 0, None)
        if entry is None:
            continue
        answer = Answer(entry[0], body, entry[1], time.perf_counter())
        log.answers.append(answer)
        if on_answer is not None:
            on_answer(answer)
