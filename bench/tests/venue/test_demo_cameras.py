"""The demonstration's monitoring cameras: where they hang, and that their frames stay fresh."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from app.geometry.se3 import Pose
from app.settings import Settings
from bench.anchors.demo_cameras import CAMERA_ROOMS, PUSH_EVERY_S, FreshFrames, camera_id
from bench.recordings.monitors import MonitorPair
from bench.venue.decor import wall_prints
from bench.venue.layout import WING_ROOMS, room_by_id


class Received:
    """A server that counts the frames of each path; the first one is refused."""

    def __init__(self) -> None:
        self.paths: Counter[str] = Counter()
        self.enough = threading.Event()
        received = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                self.rfile.read(int(self.headers["Content-Length"]))
                is_first = not received.paths
                received.paths[self.path] += 1
                if len(received.paths) == len(CAMERA_ROOMS) and min(received.paths.values()) >= 2:
                    received.enough.set()
                self.send_response(503 if is_first else 200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                """Say nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self.server.server_port}"


@pytest.fixture
def received() -> Iterator[Received]:
    one = Received()
    thread = threading.Thread(target=one.server.serve_forever, daemon=True)
    thread.start()
    yield one
    one.server.shutdown()
    one.server.server_close()
    thread.join()


def pairs(folder: Path) -> list[MonitorPair]:
    picture = folder / "monitor.jpg"
    picture.write_bytes(b"a frame")
    return [
        MonitorPair(
            name=f"pair_{number}",
            floor=0,
            monitor=picture,
            phone=picture,
            world_from_monitor=Pose.identity(),
            world_from_phone=Pose(np.eye(3), np.ones(3)),
            pois=(),
            seen=(),
            angle_deg=30.0,
            distance_m=3.0,
        )
        for number in range(len(CAMERA_ROOMS))
    ]


def test_the_cameras_hang_where_the_wing_was_not_scanned() -> None:
    assert len(CAMERA_ROOMS) == 3
    assert not set(CAMERA_ROOMS) & set(WING_ROOMS)
    assert all(len(wall_prints(room_by_id(room))) >= 2 for room in CAMERA_ROOMS)


def test_frames_are_pushed_well_before_they_are_too_old() -> None:
    assert Settings.model_fields["anchor_max_age_s"].default >= 2 * PUSH_EVERY_S


def test_every_camera_sends_its_frame_again_and_again(received: Received, tmp_path: Path) -> None:
    with FreshFrames(received.address, pairs(tmp_path), every_s=0.01):
        assert received.enough.wait(30)
    assert set(received.paths) == {f"/anchors/{camera_id(number)}/frames" for number in range(3)}
    # A frame that was refused is followed by the next one.
    assert min(received.paths.values()) >= 2


def test_a_server_that_is_gone_ends_nothing(tmp_path: Path) -> None:
    with FreshFrames("http://127.0.0.1:9", pairs(tmp_path), every_s=0.01) as frames:
        assert not threading.Event().wait(0.1)
        assert frames.is_running
    assert not frames.is_running
