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


def open_stream(server: LiveServer, session: str, token: str, picture: bytes) -> None:
    """Send a picture by a stream that a token lets in by a subprotocol; in the address it is not taken."""
    stream = f"{server.url.replace('http', 'ws', 1)}/sessions/{session}/stream"
    offered = [Subprotocol("roomfix"), Subprotocol(f"roomfix.key.{token}")]
    with connect(stream, subprotocols=offered) as socket_:
        assert socket_.subprotocol == "roomfix"
        socket_.send(picture)
        socket_.recv(timeout=60)
    with pytest.raises(InvalidStatus):
        connect(f"{stream}?key={token}")


def ordered_calls() -> list[str]:
    """Return every call of the API; what deletes comes last, and the venue at the very end."""
    found = calls(create_app(Settings(_env_file=None, open=True), NoRunner()))
    http = (call for call in found if not call.startswith("WS"))
    return sorted(http, key=lambda call: (call.startswith("DELETE"), -len(call)))


def whole_api(
    client: httpx.Client, ids: dict[str, str], secrets: list[str], picture: bytes
) -> list[httpx.Response]:
    """Make every call: every key with its right body, other bodies with a right key and a wrong one. What an answer
    shows of a new key joins the secrets."""
    answers: list[httpx.Response] = []
    callers = [*reversed(secrets)]
    for call in ordered_calls():
        for number, request in enumerate(requests_of(call, ids, picture)):
            for key in callers if number == 0 else (GUESSED, ADMIN_KEY):
                headers = {**request.get("headers", {}), "Authorization": f"Bearer {key}"}
                in_address = {"params": {"key": key}} if key.startswith("rft_") else {}
                answers.append(client.request(**{**request, "headers": headers, **in_address}))
                secrets += made_secrets(answers[-1])
    return answers


def assert_silent(text: str, secrets: list[str], picture: bytes) -> None:
    """Check that a text holds no key, no token and no byte of a picture."""
    for secret in secrets:
        assert secret not in text
        assert secret[-16:] not in text
    assert "JFIF" not in text
    assert picture[:4].hex(" ") not in text.lower()
    assert repr(picture[:12])[2:-1] not in text
    assert base64.b64encode(picture[:12]).decode() not in text


def test_nothing_secret_is_logged_at_debug_level(server: LiveServer, queries: list[View]) -> None:
    picture = queries[0].jpeg()
    secrets = [ADMIN_KEY, GUESSED]
    headers = {"Authorization": f"Bearer {ADMIN_KEY}"}
    with httpx.Client(base_url=server.url, headers=headers, timeout=60) as client:
        assert client.post("/venues", json={"id": VENUE, "name": VENUE}).status_code == 201
        client.put(f"/venues/{VENUE}/floors/0", json=FLOOR)
        client.put(f"/anchors/{CAMERA}", json=ANCHOR)
        for scope in ("locate", "anchor", "admin"):
            made = client.post("/keys", json={"name": "app", "scope": scope, "venue": VENUE})
            secrets += made_secrets(made)
        secrets += made_secrets(client.post("/tokens", json={"venue": VENUE}))
        session = client.post("/sessions", json={"venue": VENUE}).json()["session"]
        open_stream(server, session, secrets[-1], picture)
        submitted = client.post("/database/build", data={"venue": VENUE}, files={"archive": picture})
        build = submitted.json()["build"]
        recording = client.post("/recordings", json={"venue": VENUE}).json()["recording"]
        begun = client.post("/uploads", headers={"Upload-Length": "10", "Tus-Resumable": "1.0.0"})
        upload = begun.headers["location"].rsplit("/", 1)[-1]
        # Ended, so that its events end too.
        client.delete(f"/database/builds/{build}")
        ids = {
            "venue": VENUE, "floor": "0", "session": session, "build": build, "camera": CAMERA, "version": "1",
            "keyframe": "0", "picture": "0", "key": "0" * 16, "recording": recording, "number": "0", "upload": upload,
            "zoom": "0", "column": "0", "row": "0",
        }  # fmt: skip
        answers = whole_api(client, ids, secrets, picture)
        metrics = client.get("/metrics").text
    assert len(answers) > 400
    assert {401, 403, 404, 422, 200, 201, 204} <= {answer.status_code for answer in answers}
    assert not [answer.url.path for answer in answers if answer.status_code >= 500]
    assert len(secrets) > 10
    log = server.log.read_text(encoding="utf-8")
    # Detailed, and the refused stream is in it.
    assert "[debug" in log
    assert "/stream" in log
    errors = "\n".join(answer.text for answer in answers if answer.status_code >= 400)
    for text in (log, metrics, errors):
        assert_silent(text, secrets, picture)
