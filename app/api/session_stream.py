"""The stream of a session: frames in, answers out, the newest frame first."""

from __future__ import annotations

import asyncio
import json
import logging
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakValueDictionary

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from starlette.websockets import WebSocketState

from app.api.access.credentials import SUBPROTOCOL
from app.api.access.gate import admit
from app.api.deps import AppState
from app.api.errors import headers_of, problem, status_of
from app.api.requests.axes import Axes, parse_axes, parse_frames
from app.api.requests.contract_route import refuse_unknown_query
from app.api.requests.names import known_names, refuse_unknown_keys
from app.api.requests.read_json import read_json
from app.api.sessions import frame_body, parse_motion, session_frame
from app.api.stream.messages import StreamedFrame, StreamHints, StreamProblem
from app.errors import (
    BusyError,
    ConflictError,
    ImageTooLargeError,
    InvalidInputError,
    NotFoundError,
    RoomfixError,
)
from app.geometry.se3 import Pose
from app.limits import limit
from app.services.sessions import SessionFrame
from app.storage.keys import Scope

log = logging.getLogger("roomfix.api")
UNEXPECTED = "Something went wrong here with this frame; the log has it."
router = APIRouter(tags=["sessions"])
# What a key of the stream needs.
SCOPES: tuple[Scope, ...] = ("locate",)
HINTS = tuple(StreamHints.model_fields)
# Close code: another connection has taken the session over.
CLOSE_REPLACED = 4000
# Close code of RFC 6455: a message is too large.
CLOSE_TOO_BIG = 1009
# Close code of IANA's registry: the server restarts; the session goes on at another connection.
CLOSE_RESTART = 1012
# Close code: the session has ended.
CLOSE_GONE = 4404


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamOptions:
    """How a stream takes messages and answers them."""

    max_hint_characters: int = limit(
        10_000,
        "Largest length of a text message with hints.",
        chosen="By hand: the longest hints have some hundred characters.",
    )
    retry_s: float = limit(
        0.02,
        "While all workers are occupied: time until the frame that waits, or a newer one, is tried again.",
        chosen="By hand: short beside the time of a frame.",
    )


OPTIONS = StreamOptions()


@dataclass(frozen=True, slots=True)
class Waiting:
    """A frame that waits; `received` counts the frames of this connection from 1. `motion` is since the last frame
    that was taken up, None when that is not known."""

    received: int
    data: bytes
    hints: dict[str, str]
    motion: Pose | None


@dataclass(eq=False, kw_only=True)
class Stream:
    """One connection. What waits is one frame at most: a newer one takes its place."""

    socket: WebSocket
    session: str
    waiting: Waiting | None = None
    hints: dict[str, str] = field(default_factory=dict)
    received: int = 0
    arrived: asyncio.Event = field(default_factory=asyncio.Event)
    # Held while a frame is answered.
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)

    def put(self, data: bytes) -> None:
        """Let a frame wait in place of the one that does; the way between the two is not forgotten."""
        self.received += 1
        hints, self.hints = self.hints, {}
        motion = parse_motion(hints.pop("motion", None), parse_axes(hints.get("axes")))
        if self.waiting is not None:
            skipped = self.waiting.motion
            motion = None if motion is None or skipped is None else skipped @ motion
        self.waiting = Waiting(self.received, data, hints, motion)
        self.arrived.set()

    async def take(self) -> Waiting:
        """Return the newest frame as soon as there is one."""
        await self.arrived.wait()
        self.arrived.clear()
        assert self.waiting is not None  # noqa: S101 - set before the event
        waiting, self.waiting = self.waiting, None
        return waiting

    def note_hints(self, text: str) -> None:
        """Keep what a text message says of the next frame; raises `InvalidInputError`."""
        if len(text) > OPTIONS.max_hint_characters:
            raise InvalidInputError(f"Hints have at most {OPTIONS.max_hint_characters:,} characters.")
        values = read_json(text, "A text message with hints")
        if not isinstance(values, dict):
            raise InvalidInputError(f"Hints are an object with some of {', '.join(HINTS)}.")
        refuse_unknown_keys(values, known_names(HINTS))
        self.hints = {name: _text(value) for name, value in values.items() if value is not None}


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(str(part) for part in value)
    return value if isinstance(value, str) else json.dumps(value)


_streams: WeakValueDictionary[str, Stream] = WeakValueDictionary()


@router.websocket("/sessions/{session}/stream")
async def stream(socket: WebSocket, session: str) -> None:
    """Binary messages are frames; a text message before one holds its hints; each answer is one text message.

    The key is in the header `Authorization`, or in the subprotocol `roomfix.key.KEY` offered beside `roomfix`.
    """
    state = socket.app.state.roomfix
    assert isinstance(state, AppState)  # noqa: S101 - set by the lifespan
    try:
        await admit(socket, SCOPES)
        refuse_unknown_query(socket)
        await asyncio.to_thread(state.services.sessions.get, session)
    except RoomfixError as error:
        status = status_of(error)
        await socket.send_denial_response(problem(status, error.code, str(error), headers_of(error, status)))
        return
    await socket.accept(SUBPROTOCOL if SUBPROTOCOL in socket.scope.get("subprotocols", []) else None)
    connection = Stream(socket=socket, session=session)
    # A phone that comes back may do so before its old connection is known to be dead.
    older, _streams[session] = _streams.get(session), connection
    if older is not None:
        await _close(older.socket, CLOSE_REPLACED, "Another connection has taken over this session.")
    tasks = [
        asyncio.create_task(_answer(state, connection)),
        asyncio.create_task(_close_when_leaving(state, connection)),
    ]
    try:
        with state.drain.holding():
            await _receive(connection, state.services.resources.settings.max_image_bytes)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _close_when_leaving(state: AppState, connection: Stream) -> None:
    """Close the stream when the server stops, after the answer to the frame that is worked on."""
    await state.drain.closing.wait()
    async with connection.turn:
        await _close(connection.socket, CLOSE_RESTART, "The server restarts: connect again.")


async def _receive(connection: Stream, max_bytes: int) -> None:
    """Take messages until the phone goes away."""
    socket = connection.socket
    try:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            if data is not None and len(data) > max_bytes:
                await _send_problem(
                    connection, ImageTooLargeError(f"A frame has at most {max_bytes:,} bytes."), None
                )
                await _close(socket, CLOSE_TOO_BIG, "The frame is too large.")
                return
            try:
                if data is not None:
                    connection.put(data)
                else:
                    connection.note_hints(message.get("text") or "")
            except InvalidInputError as error:
                await _send_problem(connection, error, connection.received)
    except (WebSocketDisconnect, RuntimeError):
        return


async def _answer(state: AppState, connection: Stream) -> None:
    """Answer the newest frame, again and again, until the session or the server ends."""
    is_over = False
    while not is_over:
        waiting = await connection.take()
        async with connection.turn:
            # A frame that isn't begun is sent again to the server that the phone connects to next.
            is_over = state.drain.closing.is_set() or await _answer_frame(state, connection, waiting)


async def _answer_frame(state: AppState, connection: Stream, waiting: Waiting) -> bool:
    """Answer a frame, or put it back while all workers are occupied; return whether the session has ended."""
    try:
        frames = parse_frames(waiting.hints.get("axes"), waiting.hints.get("device_pose"))
        frame = _frame(waiting, frames.axes)
        answer = await state.executor.run(lambda: state.services.sessions.process(connection.session, frame))
    except (BusyError, ConflictError):
        _put_back(connection, waiting)
        await asyncio.sleep(OPTIONS.retry_s)
        return False
    except NotFoundError as error:
        await _send_problem(connection, error, waiting.received)
        await _close(connection.socket, CLOSE_GONE, "The session has ended.")
        return True
    except RoomfixError as error:
        await _send_problem(connection, error, waiting.received)
        return False
    except Exception:
        # As for a request: the log has the cause, the phone an answer, and the next frame its chance.
        log.exception("frame %d of session %s failed", waiting.received, connection.session)
        await _send_problem(connection, RoomfixError(UNEXPECTED), waiting.received)
        return False
    result = answer.result
    state.metrics.observe_query(result)
    body = StreamedFrame.of(frame_body(answer, frames), waiting.received)
    await _send(connection.socket, body.model_dump_json(exclude_unset=True))
    return False


def _put_back(connection: Stream, waiting: Waiting) -> None:
    """Let a frame wait on, unless a newer one does."""
    if connection.waiting is None:
        connection.waiting = waiting
        connection.arrived.set()


def _frame(waiting: Waiting, axes: Axes) -> SessionFrame:
    hints = waiting.hints
    frame = session_frame(
        waiting.data, hints.get("camera"), hints.get("gravity"), None, hints.get("timestamp"), axes=axes
    )
    return replace(frame, motion=waiting.motion)


async def _send_problem(connection: Stream, error: RoomfixError, received: int | None) -> None:
    body = StreamProblem(status=status_of(error), code=error.code, detail=str(error), received=received)
    await _send(connection.socket, body.model_dump_json())


async def _send(socket: WebSocket, text: str) -> None:
    if socket.application_state is WebSocketState.CONNECTED:
        try:
            await socket.send_text(text)
        except (WebSocketDisconnect, RuntimeError):
            return


async def _close(socket: WebSocket, code: int, reason: str) -> None:
    if socket.application_state is WebSocketState.CONNECTED:
        try:
            await socket.close(code, reason)
        except (WebSocketDisconnect, RuntimeError):
            return
