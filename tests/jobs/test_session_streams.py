"""Several phones on a real server: each gets its newest answer, and nothing piles up."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest
import websockets
from websockets.asyncio.client import connect

from app.commands import stream_client
from app.commands.stream_client import StreamLog, StreamOptions, start_session, stream_frames
from tests.jobs.test_session_kill import ready, serve
from tests.ports import free_port
from tests.scenes import CAMERA_TEXT, Room, pose_at
from tests.server import WAIT_S, Server

PHONES, FPS, SECONDS = 4, 10.0, 5


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[str]:
    """A server in a process of its own, with a map."""
    folder: Path = tmp_path_factory.mktemp("streams")
    port = free_port()
    process = serve(folder, port)
    try:
        ready(port, process)
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=WAIT_S) as client:
            server = Server(client, folder)
            server.add_venue("museum")
            server.add_map(scan_zip, "museum", gravity=[0, 0, -1])
        yield f"http://127.0.0.1:{port}"
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def video(room: Room) -> list[bytes]:
    """Frames of a slow walk."""
    count = int(FPS * SECONDS)
    return [room.view(pose_at(1.6 + 0.01 * i, 1.4, 1.45, -20 + 0.8 * i, 1.0)).jpeg() for i in range(count)]


async def pending(address: str, seen: list[float]) -> None:
    """Note again and again how many queries run or wait in the server."""
    async with httpx.AsyncClient(base_url=address) as client:
        while True:
            text = (await client.get("/metrics")).text
            line = next(line for line in text.splitlines() if line.startswith("roomfix_queries_pending "))
            seen.append(float(line.split()[1]))
            await asyncio.sleep(0.2)


async def run_phones(address: str, video: list[bytes], seen: list[float]) -> list[StreamLog]:
    watching = asyncio.create_task(pending(address, seen))
    sessions = [start_session(address, None, venue="museum", camera=CAMERA_TEXT) for _ in range(PHONES)]
    logs = await asyncio.gather(*(stream_frames(address, session, video, fps=FPS) for session in sessions))
    watching.cancel()
    return list(logs)


def test_four_phones_get_their_newest_answers(
    address: str, video: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_client, "OPTIONS", StreamOptions(last_answer_s=WAIT_S))
    seen: list[float] = []
    logs = asyncio.run(run_phones(address, video, seen))
    for log in logs:
        answered = [answer.sent for answer in log.answers]
        assert answered == sorted(set(answered))
        assert answered[-1] == log.last
        assert log.answers[-1].body["located"]
    # A frame of each phone at most is worked on or waits, however many were sent.
    assert seen
    assert max(seen) <= PHONES


def test_a_message_of_a_hundred_megabytes_is_refused_by_the_server(address: str) -> None:
    session = start_session(address, None, venue="museum", camera=CAMERA_TEXT)

    async def flood() -> int | None:
        async with connect(f"{address.replace('http', 'ws')}/sessions/{session}/stream") as socket:
            with suppress(websockets.ConnectionClosed, OSError):
                await socket.send(bytes(100_000_000))
                while True:
                    await socket.recv()
            return socket.close_code

    assert asyncio.run(flood()) in (1009, 1006)
    assert httpx.get(f"{address}/sessions/{session}").json()["frames"] == 0
