"""Connections that never finish what they began, on a real server."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress

import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from app.commands.serving.connections import (
    CLOSE_TOO_BIG,
    OPTIONS,
    ConnectionOptions,
    DeadlineProtocol,
    FragmentLimitProtocol,
    connection_options,
)
from tests.ports import free_port
from tests.server import wait_for

SHORT = ConnectionOptions(headers_s=0.5, silence_s=0.5, unread_s=0.5, check_s=0.05)


# Set when the server has given up an answer.
GIVEN_UP = threading.Event()


async def echo(request: Request) -> PlainTextResponse:
    return PlainTextResponse(str(len(await request.body())))


async def endless(_: Request) -> StreamingResponse:
    async def pieces() -> AsyncIterator[bytes]:
        try:
            while True:
                await asyncio.sleep(0)
                yield bytes(65_536)
        finally:
            GIVEN_UP.set()

    return StreamingResponse(pieces())


async def lengths(socket: WebSocket) -> None:
    await socket.accept()
    while (message := await socket.receive())["type"] != "websocket.disconnect":
        await socket.send_text(str(len(message["bytes"])))


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """The port of a server with short deadlines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DeadlineProtocol, "options", SHORT)
        patch.setattr(FragmentLimitProtocol, "options", ConnectionOptions(max_fragments=50))
        port = free_port()
        app = Starlette(
            routes=[
                Route("/", echo, methods=["POST"]),
                Route("/endless", endless),
                WebSocketRoute("/ws", lengths),
            ]
        )
        server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error", **connection_options()))
        thread = threading.Thread(target=server.run)
        thread.start()
        wait_for(lambda: server.started)
        yield port
        server.should_exit = True
        thread.join()


def test_an_answer_that_nobody_reads_is_given_up(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as connection:
        connection.sendall(b"GET /endless HTTP/1.1\r\nHost: x\r\n\r\n")
        assert connection.recv(12) == b"HTTP/1.1 200"
        assert GIVEN_UP.wait(20.0)


def received_until_closed(port: int, *parts: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as connection:
        for part in parts:
            connection.sendall(part)
        data = b""
        while chunk := connection.recv(1000):
            data += chunk
    return data


@pytest.mark.parametrize(
    "sent",
    [b"", b"POST / HTTP/1.1\r\nHost: x\r\n", b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\nhalf"],
    ids=["nothing", "half headers", "half a body"],
)
def test_half_a_request_is_closed(port: int, sent: bytes) -> None:
    assert received_until_closed(port, sent).startswith(b"HTTP/1.1 408 ")


def test_half_a_request_after_a_whole_one_is_closed(port: int) -> None:
    whole = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 4\r\n\r\nbody"
    answers = received_until_closed(port, whole + b"POST / HT")
    assert answers.startswith(b"HTTP/1.1 200 ")
    assert b"HTTP/1.1 408 " in answers


def test_a_message_in_countless_fragments_closes_its_connection(port: int) -> None:
    async def scenario() -> tuple[str, int]:
        async with connect(f"ws://127.0.0.1:{port}/ws") as stream:
            await stream.send([b"x"] * 40)
            answer = await stream.recv()
            # The connection may be closed before all of them are sent.
            with suppress(ConnectionClosed):
                await stream.send([b"x"] * 100_000)
            with pytest.raises(ConnectionClosed) as closed:
                await stream.recv()
            # What was sent meanwhile may reset the connection before the close frame is read.
            return str(answer), CLOSE_TOO_BIG if closed.value.rcvd is None else closed.value.rcvd.code

    assert asyncio.run(scenario()) == ("40", CLOSE_TOO_BIG)
    assert OPTIONS.max_fragments > 50
