"""Large answers: made once for all who ask, off the threads that answer the rest, and written as they are read."""

from __future__ import annotations

import asyncio
import gzip
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import Message

from app.api.answers.drawings import DrawingOptions, Drawings
from app.api.answers.writing import WritingMiddleware, WritingOptions, Written
from app.errors import BusyError, NotFoundError
from tests.ports import free_port
from tests.server import listening, wait_for

BODY = bytes(range(256)) * 4096


def test_what_many_ask_for_is_made_once() -> None:
    made, free = [], threading.Event()

    def make() -> bytes:
        made.append(1)
        free.wait()
        return BODY

    async def ask() -> list[Any]:
        drawings = Drawings()
        asked = [asyncio.ensure_future(drawings.get("a", make)) for _ in range(50)]
        await asyncio.sleep(0)
        # The client that asked first goes.
        asked[0].cancel()
        free.set()
        found = await asyncio.gather(*asked[1:])
        found.append(await drawings.get("a", make))
        drawings.close()
        return found

    found = asyncio.run(ask())
    assert len(made) == 1
    # Not fifty copies of it.
    assert len({id(each.plain) for each in found}) == len({id(each.packed) for each in found}) == 1
    assert gzip.decompress(found[0].packed) == found[0].plain == BODY


def test_what_fails_is_tried_again() -> None:
    def fail() -> bytes:
        raise NotFoundError("no map")

    async def ask() -> bytes:
        drawings = Drawings()
        with pytest.raises(NotFoundError):
            await drawings.get("a", fail)
        found = await drawings.get("a", lambda: b"there now")
        drawings.close()
        return found.plain

    assert asyncio.run(ask()) == b"there now"


def test_too_many_drawings_are_refused() -> None:
    free = threading.Event()

    async def ask() -> None:
        drawings = Drawings(DrawingOptions(threads=1, waiting=1))
        running = [asyncio.ensure_future(drawings.run(free.wait)) for _ in range(2)]
        await asyncio.sleep(0)
        with pytest.raises(BusyError):
            await drawings.get("a", lambda: BODY)
        free.set()
        await asyncio.gather(*running)
        assert (await drawings.get("a", lambda: BODY)).plain == BODY
        drawings.close()

    asyncio.run(ask())


def test_health_is_answered_while_all_threads_of_calls_are_taken(tmp_path: Path) -> None:
    with listening(tmp_path) as (url, app), httpx.Client(base_url=url) as client:
        client.post("/venues", json={"id": "v", "name": "V"})
        free, taken = threading.Event(), []

        @app.get("/taken")
        def take() -> None:
            taken.append(1)
            free.wait()

        async def ask() -> list[httpx.Response]:
            async with httpx.AsyncClient(base_url=url, timeout=60.0) as many:
                waiting = [asyncio.ensure_future(many.get("/taken")) for _ in range(45)]
                try:
                    while len(taken) < 40:
                        await asyncio.sleep(0.01)
                    health = await many.get("/healthz")
                    query = await many.post("/locate", data={"venue": "v"}, files={"image": b"no picture"})
                finally:
                    free.set()
                await asyncio.gather(*waiting)
                return [health, query]

        health, query = asyncio.run(ask())
        assert (health.status_code, query.status_code) == (200, 415)


def test_a_body_is_given_out_as_it_is_read() -> None:
    sent: list[Message] = []

    async def run() -> None:
        full = asyncio.Event()

        async def send(message: Message) -> None:
            sent.append(message)
            if len(sent) == 4:
                # The connection's buffer is full.
                await full.wait()

        app = WritingMiddleware(Response(BODY), WritingOptions(piece_bytes=1000))
        task = asyncio.ensure_future(app({"type": "http", "method": "GET"}, no_more, send))
        for _ in range(20):
            await asyncio.sleep(0)
        assert len(sent) == 4
        full.set()
        await task

    asyncio.run(run())
    assert b"".join(message["body"] for message in sent[1:]) == BODY
    assert max(len(message["body"]) for message in sent[1:]) == 1000
    assert [message.get("more_body", False) for message in sent[1:]] == [True] * (len(sent) - 2) + [False]


async def no_more() -> Message:
    return {"type": "http.disconnect"}


def test_a_shared_body_counts_once() -> None:
    written, other = Written(len(BODY) + 1), bytes(len(BODY))
    with written.holding(BODY), written.holding(BODY):
        assert written.total == len(BODY)
        with pytest.raises(BusyError), written.holding(other):
            pass
    assert written.total == 0
    # One alone is written however large it is.
    with written.holding(other * 2):
        assert written.total == 2 * len(BODY)


@pytest.fixture
def url() -> Iterator[str]:
    """A server whose every answer is a body of its own, with room for one that is being written."""
    port = free_port()

    async def large(_: Request) -> Response:
        return Response(bytes(20_000_000))

    app = WritingMiddleware(Starlette(routes=[Route("/", large)]), WritingOptions(written_bytes=30_000_000))
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


def test_an_answer_without_room_beside_those_that_are_read_slowly_is_a_503(url: str) -> None:
    address = urlsplit(url)
    with socket.create_connection((address.hostname, address.port)) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        assert slow.recv(12) == b"HTTP/1.1 200"
        refused = httpx.get(url)
        assert refused.status_code == 503
        assert refused.headers["retry-after"]
        assert refused.json()["code"] == "busy"
    wait_for(lambda: httpx.get(url).status_code == 200)
    assert len(httpx.get(url).content) == 20_000_000
