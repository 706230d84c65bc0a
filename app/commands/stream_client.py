"""A phone, as the server sees one: frames by WebSocket at their rate, and a new connection when one breaks."""

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

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")
JPEG_QUALITY = 90
RETRY_S = 0.2
OnAnswer = Callable[["Answer"], None]


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer: which of the sent frames it is for, from 0, the JSON, when both went over the line."""

    sent: int
    body: dict[str, Any]
    sent_at: float
    received_at: float

    @property
    def latency_ms(self) -> float:
        """From the frame's leaving to its answer."""
        return 1e3 * (self.received_at - self.sent_at)


@dataclass(slots=True)
class StreamLog:
    """What a phone has seen: frames sent and the number of the last one, answers, connections made again."""

    sent: int = 0
    last: int = -1
    reconnects: int = 0
    answers: list[Answer] = field(default_factory=list)


def read_frames(source: Path, limit: int | None = None) -> list[bytes]:
    """Return the frames of a folder's images, by name, or of a video file as JPEG; at most `limit`.

    Raises `InvalidInputError` for a source without frames.
    """
    if source.is_dir():
        files = sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)[:limit]
        frames = [path.read_bytes() for path in files]
    else:
        frames = _video_frames(source, limit)
    if not frames:
        raise InvalidInputError(f"{source} holds no frames: give a folder of JPEG, PNG or WebP, or a video.")
    return frames


def _video_frames(source: Path, limit: int | None) -> list[bytes]:
    video = cv2.VideoCapture(str(source))
    frames: list[bytes] = []
    try:
        while limit is None or len(frames) < limit:
            read, image = video.read()
            if not read:
                break
            frames.append(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())
    finally:
        video.release()
    return frames


def start_session(server: str, key: str | None, **fields: Any) -> str:
    """Start a session and return its id; raises `RoomfixError` with the server's sentence."""
    given = {name: value for name, value in fields.items() if value is not None}
    answer = httpx.post(f"{server}/sessions", json=given, headers=_headers(key), timeout=30.0)
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
    give_up_s: float = 30.0,
    is_enough: Callable[[], bool] = lambda: False,
) -> StreamLog:
    """Send frames at their rate, whether the last one was answered or not, and return what came back.

    A connection that breaks is made anew, and the session goes on with the frame that is due then: a camera
    doesn't wait. Ends before the last frame when `is_enough` says so. Raises `RoomfixError` when the server
    refuses, or stays away for longer than `give_up_s`.
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
            await asyncio.sleep(RETRY_S)


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
    """Return the number of the frame that a camera would take now."""
    return int(np.ceil((time.perf_counter() - started) * fps))


async def _wait_for_last(receiving: asyncio.Task[None], on_the_way: dict[int, Any], last: int) -> None:
    limit = time.perf_counter() + 5.0
    while last in on_the_way and not receiving.done() and time.perf_counter() < limit:
        await asyncio.sleep(0.01)


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
