"""Keys on a server in a process of its own: what its log holds, and what bodies without a key cost it."""

from __future__ import annotations

import base64
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings
from tests.api.key_rows import ANCHOR, BODIES, CAMERA, FLOOR, VENUE, calls
from tests.live_server import LiveServer, serving
from tests.scenes import CAMERA_TEXT, View

ADMIN_KEY = "the-key-of-the-settings-0123456789"
GUESSED = "guessed-key-0123456789"
HELD = 100
ALLOWED_BYTES = 20_000_000


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    folder = tmp_path_factory.mktemp("live")
    with serving(
        folder,
        ROOMFIX_ADMIN_KEY=ADMIN_KEY,
        ROOMFIX_OPEN="false",
        ROOMFIX_LOG_LEVEL="debug",
        ROOMFIX_CALLS_PER_MINUTE="0",
        ROOMFIX_WRONG_KEYS_PER_MINUTE="0",
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
        assert httpx.get(f"{server.url}/healthz", timeout=60).status_code == 200
        assert server.memory_bytes - before < ALLOWED_BYTES
        assert files_in(data) == disk
    finally:
        for connection in held:
            connection.close()


def requests_of(call: str, ids: dict[str, str], picture: bytes) -> list[dict[str, Any]]:
    """Return the bodies that a call is made with: a right one where there is one, a picture in each form, and text."""
    base64_picture = base64.b64encode(picture).decode()
    bodies = [dict(BODIES.get(call, {}))]
    if call.startswith(("POST", "PUT", "PATCH")):
        bodies += [
            {
                "data": {"venue": VENUE, "camera": CAMERA_TEXT},
                "files": {"image": picture, "archive": picture},
            },
            {"content": picture, "headers": {"Content-Type": "image/jpeg"}},
            {"json": {"image": base64_picture, "venue": VENUE, "name": base64_picture[:100]}},
            {"content": b"{", "headers": {"Content-Type": "application/json"}},
        ]
    path = re.sub(r"{(\w+)}", lambda match: ids[match[1]], call.split(" ", 1)[1])
    return [{"method": call.split(" ", 1)[0], "url": path, **body} for body in bodies]


def made_secrets(answer: httpx.Response) -> list[str]:
    """Return the key or token that an answer shows, which is its only time."""
    body = answer.json() if answer.headers.get("content-type") == "application/json" else {}
    return [str(body[name]) for name in ("text", "token") if isinstance(body, dict) and name in body]


def test_nothing_secret_is_logged_at_debug_level(server: LiveServer, queries: list[View]) -> None:
    picture = queries[0].jpeg()
    secrets = [ADMIN_KEY]
    answers: list[httpx.Response] = []
    headers = {"Authorization": f"Bearer {ADMIN_KEY}"}
    with httpx.Client(base_url=server.url, headers=headers, timeout=60) as client:
        assert client.post("/venues", json={"id": VENUE, "name": VENUE}).status_code == 201
        client.put(f"/venues/{VENUE}/floors/0", json=FLOOR)
        client.put(f"/anchors/{CAMERA}", json=ANCHOR)
        for scope in ("locate", "anchor", "admin"):
            made = client.post("/keys", json={"name": "app", "scope": scope, "venue": VENUE}).json()
            secrets.append(made["text"])
        token = client.post("/tokens", json={"venue": VENUE}).json()["token"]
        secrets.append(token)
        secrets.append(GUESSED)
        session = client.post("/sessions", json={"venue": VENUE}).json()["session"]
        stream = f"{server.url.replace('http', 'ws', 1)}/sessions/{session}/stream"
        offered = [Subprotocol("roomfix"), Subprotocol(f"roomfix.key.{token}")]
        with connect(stream, subprotocols=offered) as socket_:
            assert socket_.subprotocol == "roomfix"
            socket_.send(picture)
            socket_.recv(timeout=60)
        with pytest.raises(InvalidStatus):
            connect(f"{stream}?key={token}")

        build = client.post("/database/build", data={"venue": VENUE}, files={"archive": picture}).json()[
            "build"
        ]
        # Ended, so that its events end too.
        client.delete(f"/database/builds/{build}")
        ids = {
            "venue": VENUE, "floor": "0", "session": session, "build": build, "camera": CAMERA, "version": "1",
            "keyframe": "0", "key": "0" * 16,
        }  # fmt: skip
        all_calls = calls(create_app(Settings(_env_file=None, open=True), NoRunner()))
        # What deletes comes last, and the venue at the very end.
        ordered = sorted(
            (call for call in all_calls if not call.startswith("WS")),
            key=lambda call: (call.startswith("DELETE"), -len(call)),
        )
        assert len(ordered) > 45
        callers = [*reversed(secrets)]
        for call in ordered:
            for number, request in enumerate(requests_of(call, ids, picture)):
                # Every key with the right body; the others are read with a right key, and not with a wrong one.
                for key in callers if number == 0 else (GUESSED, ADMIN_KEY):
                    headers = {**request.get("headers", {}), "Authorization": f"Bearer {key}"}
                    in_address = {"params": {"key": key}} if key == token else {}
                    answers.append(client.request(**{**request, "headers": headers, **in_address}))
                    secrets += made_secrets(answers[-1])
        metrics = client.get("/metrics").text
    assert {401, 403, 404, 422, 200, 201, 204} <= {answer.status_code for answer in answers}
    assert not [answer.url.path for answer in answers if answer.status_code >= 500]
    errors = "\n".join(answer.text for answer in answers if answer.status_code >= 400)
    log = server.log.read_text(encoding="utf-8")
    # Detailed, and the refused stream is in it.
    assert " DEBUG " in log
    assert "/stream" in log
    assert len(secrets) > 10
    for text in (log, metrics, errors):
        for secret in secrets:
            assert secret not in text
            assert secret[-16:] not in text
        assert "JFIF" not in text
        assert picture[:4].hex(" ") not in text.lower()
        assert repr(picture[:12])[2:-1] not in text
        assert base64.b64encode(picture[:12]).decode() not in text
