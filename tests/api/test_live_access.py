"""Keys on a server in a process of its own: what its log holds, and what bodies without a key cost it."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.api.key_rows import ANCHOR, CAMERA, FLOOR, VENUE
from tests.live_server import LiveServer, serving
from tests.scenes import CAMERA_TEXT, View

ADMIN_KEY = "the-key-of-the-settings-0123456789"
HELD = 100
ALLOWED_BYTES = 20_000_000


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    folder = tmp_path_factory.mktemp("live")
    with serving(
        folder, ROOMFIX_ADMIN_KEY=ADMIN_KEY, ROOMFIX_OPEN="false", ROOMFIX_LOG_LEVEL="debug"
    ) as live:
        yield live


def files_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize(
    ("path", "kind"),
    [("/database/build", "multipart/form-data; boundary=b"), ("/locate", "multipart/form-data; boundary=b"),
     ("/venues", "application/json"), ("/anchors/a/frames", "image/jpeg")],
)  # fmt: skip
def test_held_open_bodies_without_a_key_are_refused_from_their_headers(
    server: LiveServer, path: str, kind: str
) -> None:
    host, port = urlsplit(server.url).netloc.split(":")
    data = server.log.parent / "data"
    before, disk = server.memory_bytes, files_in(data)
    head = (
        f"POST {path} HTTP/1.1\r\nHost: {host}\r\nContent-Type: {kind}\r\nContent-Length: 300000000\r\n\r\n"
    )
    held = [socket.create_connection((host, int(port)), timeout=20) for _ in range(HELD)]
    try:
        for connection in held:
            connection.sendall(head.encode())
        # Refused although nothing of the body has come.
        for connection in held:
            assert connection.recv(200).startswith(b"HTTP/1.1 401")
        for connection in held:
            connection.setblocking(False)
        for _ in range(20):
            for connection in held:
                with suppress(BlockingIOError, ConnectionError):
                    connection.send(b"x" * 100_000)
        assert httpx.get(f"{server.url}/healthz").status_code == 200
        assert server.memory_bytes - before < ALLOWED_BYTES
        assert files_in(data) == disk
    finally:
        for connection in held:
            connection.close()


def test_nothing_secret_is_logged_at_debug_level(server: LiveServer, queries: list[View]) -> None:
    picture = queries[0].jpeg()
    secrets = [ADMIN_KEY]
    with httpx.Client(base_url=server.url, headers={"Authorization": f"Bearer {ADMIN_KEY}"}) as client:
        assert client.post("/venues", json={"id": VENUE, "name": VENUE}).status_code == 201
        client.put(f"/venues/{VENUE}/floors/0", json=FLOOR)
        client.put(f"/anchors/{CAMERA}", json=ANCHOR)
        for scope in ("locate", "anchor", "admin"):
            made = client.post("/keys", json={"name": "app", "scope": scope, "venue": VENUE}).json()
            secrets.append(made["text"])
        token = client.post("/tokens", json={"venue": VENUE}).json()["token"]
        secrets.append(token)
        form = {"venue": VENUE, "camera": CAMERA_TEXT}
        for key in [*secrets, "guessed-key-0123456789"]:
            headers = {"Authorization": f"Bearer {key}"}
            client.post("/locate", data=form, files={"image": picture}, headers=headers)
            client.post(
                f"/anchors/{CAMERA}/frames",
                content=picture,
                headers={**headers, "Content-Type": "image/jpeg"},
            )
            client.post("/database/build", data={"venue": VENUE}, files={"archive": picture}, headers=headers)
            client.get("/venues", params={"key": key}, headers=headers)
        secrets.append("guessed-key-0123456789")
        session = client.post("/sessions", json={"venue": VENUE}).json()["session"]
        stream = f"{server.url.replace('http', 'ws', 1)}/sessions/{session}/stream"
        offered = [Subprotocol("roomfix"), Subprotocol(f"roomfix.key.{token}")]
        with connect(stream, subprotocols=offered) as socket_:
            assert socket_.subprotocol == "roomfix"
            socket_.send(picture)
            socket_.recv(timeout=60)
        with pytest.raises(InvalidStatus):
            connect(f"{stream}?key={token}")
        metrics = client.get("/metrics").text
    text = server.log.read_text(encoding="utf-8") + metrics
    # Detailed, and the refused stream is in it.
    assert "[debug" in text
    assert "/stream" in text
    for secret in secrets:
        assert secret not in text
        assert secret[-16:] not in text
    assert "JFIF" not in text
    assert picture[:4].hex(" ") not in text.lower()
    assert repr(picture[:12])[2:-1] not in text
