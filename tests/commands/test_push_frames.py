"""The process beside a monitoring camera: its sources, and what it does when the server fails."""

from __future__ import annotations

import http.server
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import httpx
import pytest

from app.commands import backoff, push_frames
from app.errors import InvalidInputError
from tests.scenes import Room, pose_at


@cache
def picture() -> bytes:
    """Return a picture of the room."""
    return Room(seed=1).view(pose_at(1.5, 1.5)).jpeg()


@contextmanager
def server(statuses: list[int]) -> Iterator[tuple[str, list[bytes]]]:
    """Serve these statuses in turn, the last one for ever; give the address and the bodies received."""
    received: list[bytes] = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(statuses[min(len(received), len(statuses)) - 1])
            self.end_headers()
            frame = {"detail": "no", "received_at": "now", "features": 3, "pois_visible": []}
            self.wfile.write(json.dumps(frame).encode())

        def log_message(self, *_: object) -> None:
            pass

    running = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=running.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{running.server_port}", received
    finally:
        running.shutdown()
        running.server_close()


def test_a_failure_is_tried_again_with_a_newer_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backoff, "OPTIONS", backoff.BackoffOptions(first_s=0.01))
    with server([503, 500, 200]) as (address, received), httpx.Client(base_url=address) as client:
        push_frames.send(client, "hall", b"old", lambda: b"new")
    assert [b"old" in body for body in received] == [True, False, False]
    assert b"new" in received[-1]


def test_what_will_never_do_ends_it() -> None:
    refused = pytest.raises(InvalidInputError, match="no")
    with server([404]) as (address, received), httpx.Client(base_url=address) as client, refused:
        push_frames.send(client, "hall", picture(), lambda: None)
    assert len(received) == 1


def test_sources(tmp_path: Path) -> None:
    for name in ("b.jpg", "a.jpg", "c.txt", "d.heic"):
        (tmp_path / name).write_bytes(name.encode())
    assert list(push_frames.open_frames(str(tmp_path))) == [b"a.jpg", b"b.jpg", b"d.heic"]
    again = push_frames.open_frames(str(tmp_path / "a.jpg"))
    assert [next(again), next(again)] == [b"a.jpg", b"a.jpg"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInputError, match="no pictures: JPEG"):
        push_frames.open_frames(str(tmp_path / "empty"))
    with pytest.raises(InvalidInputError, match="can be opened"):
        next(push_frames.open_frames(str(tmp_path / "absent.mp4")))
