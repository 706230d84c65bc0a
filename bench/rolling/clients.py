"""Clients of servers that are replaced: queries, sessions by request and by stream, an upload, and a build."""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import math
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from app.commands.stream_client import stream_frames
from app.commands.uploads.client import begin_upload, send_file
from bench.overload.request import NO_ANSWER, ask, locate_request

BUILD_VENUE = "rolling-restart"
ENDED = ("succeeded", "failed", "cancelled")
POLL_S = 1.0
TIMEOUT_S = 60.0
FRAMES_PER_S = 2.0
# Longer than any run, and without silence that the server takes for a broken connection.
SLOW_UPLOAD_S = 600.0
# More frames than are sent in any run.
MOST_FRAMES = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Used:
    """What the clients send. `upload` is a file that is sent while the servers are replaced."""

    picture: bytes
    scan: Path
    options: str
    venue: str
    camera: str | None
    upload: Path


@dataclass(slots=True)
class Answers:
    """Statuses of the answers to one kind of request, 0 for none, and when they came."""

    statuses: list[int] = field(default_factory=list)
    at_s: list[float] = field(default_factory=list)

    def note(self, status: int) -> None:
        """Note an answer that came now."""
        self.statuses.append(status)
        self.at_s.append(time.perf_counter())

    def longest_gap_s(self, until_s: float = math.inf) -> float:
        """Return the longest time between two answers of status 200, 0 for fewer than two."""
        times = zip(self.statuses, self.at_s, strict=True)
        good = [at_s for status, at_s in times if status == 200 and at_s <= until_s]
        return max((after - before for before, after in itertools.pairwise(good)), default=0.0)


@dataclass(slots=True, kw_only=True)
class Seen:
    """Answers of the clients, what became of sessions and the upload, and when the first server was replaced."""

    queries: Answers = field(default_factory=Answers)
    kept_alive: Answers = field(default_factory=Answers)
    frames: Answers = field(default_factory=Answers)
    streamed: Answers = field(default_factory=Answers)
    sessions: int = 0
    whole_sessions: int = 0
    reconnects: int = 0
    upload_parts: int = 0
    replacing_from_s: float = math.inf
    is_upload_whole: bool = False


@dataclass(frozen=True, slots=True)
class Build:
    """How a build ended."""

    id: str
    state: str
    error: str | None
    attempts: int
    maps: int


async def ask_in_turn(url: str, use: Used, seen: Seen, is_over: asyncio.Event) -> None:
    """Ask query after query until it is over, each on a connection of its own."""
    request = locate_request(url, use.picture, use.venue, use.camera)
    while not is_over.is_set():
        seen.queries.note((await ask(url, request)).status)


async def ask_kept_alive(url: str, use: Used, seen: Seen, is_over: asyncio.Event) -> None:
    """Ask query after query on one connection, as long as the server keeps it."""
    data = {"venue": use.venue} | ({"camera": use.camera} if use.camera else {})
    async with _client(url, is_kept=True) as client:
        while not is_over.is_set():
            seen.kept_alive.note(await _post(client, "/locate", use.picture, data))


async def walk(url: str, use: Used, seen: Seen, is_over: asyncio.Event) -> None:
    """Send frame after frame of one session until it is over, and compare what the session holds then."""
    async with _client(url) as client:
        session, answered = await _session(client, use, seen), 0
        while not is_over.is_set():
            status = await _post(client, f"/sessions/{session}/frames", use.picture, {})
            seen.frames.note(status)
            answered += status == 200
        seen.whole_sessions += await _held(client, session) == answered


async def stream(url: str, use: Used, seen: Seen, is_over: asyncio.Event) -> None:
    """Stream a session as a phone does until it is over."""
    async with _client(url) as client:
        session = await _session(client, use, seen)
        answers: Sequence[bytes] = [use.picture] * MOST_FRAMES
        log = await stream_frames(
            url,
            session,
            answers,
            fps=FRAMES_PER_S,
            on_answer=lambda answer: seen.streamed.note(answer.body.get("status", 200)),
            is_enough=is_over.is_set,
        )
        seen.reconnects += log.reconnects
        frames = [answer.body["frame"] for answer in log.answers if "frame" in answer.body]
        is_rising = all(before < after for before, after in itertools.pairwise(frames))
        seen.whole_sessions += bool(frames) and is_rising and await _held(client, session) >= frames[-1]


async def upload(url: str, use: Used, seen: Seen, data_dir: Path, all_replaced: threading.Event) -> None:
    """Send a file in the resumable way, slowly until all servers are replaced, and compare what has arrived."""
    length = use.upload.stat().st_size
    began = time.perf_counter()

    def slow_down(sent: int) -> None:
        all_replaced.wait(max(0.0, began + SLOW_UPLOAD_S * sent / length - time.perf_counter()))

    def count(request: httpx.Request) -> None:
        seen.upload_parts += request.method == "PATCH"

    def send() -> str:
        hooks = {"request": [count]}
        with httpx.Client(base_url=url, timeout=TIMEOUT_S, trust_env=False, event_hooks=hooks) as client:
            sent = send_file(client, begin_upload(client, length, use.venue), use.upload, slow_down)
            return sent.url.rsplit("/", 1)[-1]

    upload_id = await asyncio.to_thread(send)
    arrived = data_dir / "uploads" / f"{upload_id}.part"
    seen.is_upload_whole = _digest(arrived) == _digest(use.upload)


async def build(url: str, use: Used) -> Build:
    """Build a scan in a venue of its own and wait for its end."""
    async with _client(url) as client:
        (await client.post("/venues", json={"id": BUILD_VENUE, "name": BUILD_VENUE})).raise_for_status()
        form = {"venue": BUILD_VENUE, "options": use.options}
        data = await asyncio.to_thread(use.scan.read_bytes)
        answer = await client.post("/database/build", data=form, files={"archive": (use.scan.name, data)})
        answer.raise_for_status()
        build_id = str(answer.json()["build"])
        while (body := (await client.get(f"/database/builds/{build_id}")).json())["state"] not in ENDED:
            await asyncio.sleep(POLL_S)
        maps = (await client.get(f"/venues/{BUILD_VENUE}/maps")).json()
    return Build(build_id, body["state"], body["error"], body["attempts"], len(maps))


async def _session(client: httpx.AsyncClient, use: Used, seen: Seen) -> str:
    body = {"venue": use.venue} | ({"camera": use.camera} if use.camera else {})
    answer = await client.post("/sessions", json=body)
    answer.raise_for_status()
    seen.sessions += 1
    return str(answer.json()["session"])


async def _held(client: httpx.AsyncClient, session: str) -> int:
    """Return the number of frames that a session holds."""
    return int((await client.get(f"/sessions/{session}")).json().get("frames", -1))


async def _post(client: httpx.AsyncClient, path: str, picture: bytes, data: dict[str, str]) -> int:
    with suppress(httpx.TransportError):
        return (await client.post(path, data=data, files={"image": ("a.jpg", picture)})).status_code
    return NO_ANSWER


def _client(url: str, *, is_kept: bool = False) -> httpx.AsyncClient:
    # Else a connection for each request, as the balancer gives each to another server.
    limits = httpx.Limits(max_keepalive_connections=None if is_kept else 0)
    return httpx.AsyncClient(base_url=url, timeout=TIMEOUT_S, limits=limits, trust_env=False)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
