"""A server that is asked to stop: not ready but serving, then streams, events and uploads end, to go on elsewhere."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
import uvicorn
from sse_starlette.sse import AppStatus
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from app.commands.serving.connections import connection_options
from app.commands.serving.leaving_server import LeavingServer
from app.commands.uploads.client import PART_MEDIA_TYPE, TUS, begin_upload
from app.jobs.runner import NoRunner
from app.main import create_app
from app.settings import Settings
from tests.ports import free_port
from tests.scenes import View
from tests.server import WAIT_S, Server, assert_problem, wait_for

VENUE = "v"
# Nobody waits as long: a second signal ends it.
DRAIN_S = 3600.0
PIECE = b"x" * 1000
LENGTH = 10_000_000


@dataclass(frozen=True)
class Leaving:
    """A server, what it noted when it had started, the thread that it runs in, and a client that keeps its
    connection."""

    server: LeavingServer
    started: list[bool]
    thread: threading.Thread
    client: httpx.Client
    folder: Path

    def stop(self) -> None:
        """Send SIGTERM; the second one ends the time in which it serves on."""
        self.server.handle_exit(signal.SIGTERM, None)


@pytest.fixture
def leaving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Leaving]:
    """A server with a venue."""
    # The server changes it for the whole process.
    monkeypatch.setattr(AppStatus, "enable_automatic_graceful_drain", True)
    app, port = create_app(Settings(_env_file=None, data_dir=tmp_path, open=True), NoRunner()), free_port()
    config = uvicorn.Config(app, port=port, log_level="error", **connection_options())
    started: list[bool] = []
    server = LeavingServer(config, app.state.drain, DRAIN_S, lambda: started.append(True))
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=WAIT_S) as client:
        Server(client, tmp_path).add_venue(VENUE)
        yield Leaving(server, started, thread, client, tmp_path)
    server.should_exit = server.force_exit = True
    thread.join()


def test_it_serves_on_and_is_not_ready(leaving: Leaving) -> None:
    client = leaving.client
    assert client.get("/readyz").status_code == 200
    assert "connection" not in client.get("/venues").headers
    leaving.stop()
    wait_for(lambda: client.get("/readyz").status_code == 503)
    assert_problem(client.get("/readyz"), 503, "not_ready")
    assert client.get("/healthz").status_code == 200
    answer = client.get("/venues")
    assert (answer.status_code, answer.headers["connection"]) == (200, "close")
    leaving.stop()
    leaving.thread.join(WAIT_S)
    assert not leaving.thread.is_alive()


def test_it_says_once_that_it_has_started(leaving: Leaving) -> None:
    assert leaving.started == [True]


def test_an_interrupt_by_hand_ends_it_at_once(leaving: Leaving) -> None:
    leaving.server.handle_exit(signal.SIGINT, None)
    leaving.thread.join(WAIT_S)
    assert not leaving.thread.is_alive()


def test_a_stream_is_answered_until_it_is_closed_for_a_restart(leaving: Leaving, views: list[View]) -> None:
    session = leaving.client.post("/sessions", json={"venue": VENUE}).json()["session"]
    url = f"ws://{leaving.client.base_url.netloc.decode()}/sessions/{session}/stream"
    with connect(url) as stream:
        leaving.stop()
        wait_for(lambda: leaving.client.get("/readyz").status_code == 503)
        stream.send(views[0].jpeg())
        assert json.loads(stream.recv(WAIT_S))["frame"] == 1
        leaving.stop()
        with pytest.raises(ConnectionClosed) as closed:
            stream.recv(WAIT_S)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1012
    leaving.thread.join(WAIT_S)
    assert not leaving.thread.is_alive()


def test_events_of_a_build_that_goes_on_end(leaving: Leaving, scan_zip: bytes) -> None:
    build = Server(leaving.client, leaving.folder).submit(scan_zip, VENUE).json()["build"]
    with leaving.client.stream("GET", f"/database/builds/{build}/events") as events:
        lines = events.iter_lines()
        assert next(lines) == "event: build"
        leaving.stop()
        leaving.stop()
        # The stream ends in order, not by a broken connection.
        assert not [line for line in lines if line.startswith("event:")]
    leaving.thread.join(WAIT_S)
    assert not leaving.thread.is_alive()


def test_a_part_of_an_upload_ends_and_what_arrived_is_kept(leaving: Leaving) -> None:
    url = begin_upload(leaving.client, LENGTH, VENUE)
    stored = leaving.folder / "uploads" / f"{url.rsplit('/', 1)[-1]}.part"
    sent = 0

    def pieces() -> Iterator[bytes]:
        nonlocal sent
        pause = threading.Event()
        while leaving.thread.is_alive() and sent < LENGTH // 2:
            yield PIECE
            sent += len(PIECE)
            if sent == 10 * len(PIECE):
                leaving.stop()
                leaving.stop()
            pause.wait(0.01)

    headers = {**TUS, "Upload-Offset": "0", "Content-Type": PART_MEDIA_TYPE, "Content-Length": str(LENGTH)}
    with httpx.Client(base_url=leaving.client.base_url, timeout=WAIT_S) as client:
        try:
            answer = client.patch(url, headers=headers, content=pieces())
        except httpx.TransportError:
            # What is sent after the answer breaks the connection.
            pass
        else:
            assert (answer.status_code, int(answer.headers["Upload-Offset"])) == (204, stored.stat().st_size)
    leaving.thread.join(WAIT_S)
    assert sent < LENGTH // 2
    assert 10 * len(PIECE) <= stored.stat().st_size <= sent + len(PIECE)
