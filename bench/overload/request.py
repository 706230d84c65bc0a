"""Single requests as bytes on a connection of their own, as cheap for the one who measures as can be."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

BOUNDARY = "bench-boundary"
# Of an answer that never came.
NO_ANSWER = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer's status, when it came, and how long after its request began."""

    status: int
    at_s: float
    seconds: float


def locate_request(url: str, image: bytes, venue: str, camera: str | None) -> bytes:
    """Return a whole request of `POST /locate`."""
    fields = {"venue": venue} | ({"camera": camera} if camera else {})
    parts = [
        f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'
        for name, value in fields.items()
    ]
    head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="image"; filename="a.jpg"\r\n\r\n'
    body = ("".join(parts) + head).encode() + image + f"\r\n--{BOUNDARY}--\r\n".encode()
    kind = f"multipart/form-data; boundary={BOUNDARY}"
    return _head("POST", "/locate", url, f"Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n") + body


def get_request(url: str, path: str) -> bytes:
    """Return a whole request without a body."""
    return _head("GET", path, url, "")


def _head(method: str, path: str, url: str, more: str) -> bytes:
    host = urlsplit(url).netloc
    return f"{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n".encode()


async def ask(url: str, request: bytes) -> Answer:
    """Send a request on a connection of its own and return its answer; its status is 0 when there is none."""
    began = time.perf_counter()
    status = NO_ANSWER
    with suppress(OSError, ValueError, IndexError):
        reader, writer = await open_connection(url)
        try:
            # A server that refuses may answer before it has read the whole request.
            with suppress(ConnectionError):
                writer.write(request)
            status = int((await reader.readline()).split()[1])
            await reader.read()
        finally:
            writer.close()
    ended = time.perf_counter()
    return Answer(status, ended, ended - began)


async def open_connection(url: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect to a server."""
    parts = urlsplit(url)
    return await asyncio.open_connection(parts.hostname, parts.port)
