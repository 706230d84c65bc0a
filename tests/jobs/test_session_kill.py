"""A server that is killed while phones stream: they connect again and are tracked on."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from pathlib import Path

import httpx
import pytest

from app.commands.stream_client import Answer, StreamLog, start_session, stream_frames
from tests.jobs.test_kill import _is_ready
from tests.ports import free_port
from tests.scenes import CAMERA_TEXT, Room, pose_at
from tests.server import Server, wait_for

FPS = 10.0
# Two seconds of frames, after which a phone must be tracked again.
FRAMES_TO_TRACKING = 20


def serve(data_dir: Path, port: int) -> subprocess.Popen[bytes]:
    """Start the server as it is started by people."""
    command = [sys.executable, "-m", "app.cli", "serve", "--data-dir", str(data_dir), "--port", str(port)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen([*command, "--open"], env=environment, stderr=subprocess.DEVNULL)


def ready(port: int, process: subprocess.Popen[bytes]) -> None:
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30.0) as client:
        wait_for(lambda: _is_ready(client) or process.poll() is not None)
    assert process.poll() is None


@pytest.fixture(scope="module")
def video(room: Room) -> list[bytes]:
    """Frames of a slow walk there and back, long enough for a restart."""
    there = [
        room.view(pose_at(1.6 + 0.01 * i, 1.4 + 0.005 * i, 1.45, -20 + 0.8 * i, 1.0)).jpeg()
        for i in range(60)
    ]
    return (there + there[::-1]) * 10


class Phone(threading.Thread):
    """A phone that streams until it has had enough answers after a restart."""

    def __init__(self, address: str, session: str, video: list[bytes]) -> None:
        super().__init__(daemon=True)
        self._stream = (address, session, video)
        self.answers: list[Answer] = []
        self.restarted_after: int | None = None
        self.log: StreamLog | None = None

    def run(self) -> None:
        """Stream."""
        address, session, video = self._stream
        self.log = asyncio.run(
            stream_frames(
                address,
                session,
                video,
                fps=FPS,
                on_answer=self.answers.append,
                give_up_s=90,
                is_enough=self.has_enough,
            )
        )

    def has_enough(self) -> bool:
        """Whether as many frames as matter were answered since the restart."""
        return (
            self.restarted_after is not None
            and len(self.answers) >= self.restarted_after + FRAMES_TO_TRACKING
        )


def test_a_phone_is_tracked_again_after_the_server_was_killed(
    tmp_path: Path, scan_zip: bytes, video: list[bytes]
) -> None:
    port = free_port()
    address = f"http://127.0.0.1:{port}"
    process = serve(tmp_path, port)
    try:
        ready(port, process)
        with httpx.Client(base_url=address, timeout=60.0) as client:
            server = Server(client, tmp_path)
            server.add_venue("museum")
            server.add_map(scan_zip, "museum", gravity=[0, 0, -1])
            session = start_session(address, None, venue="museum", camera=CAMERA_TEXT)
            phone = Phone(address, session, video)
            phone.start()
            wait_for(lambda: len(phone.answers) >= 15)
            process.kill()
            process.wait()
            before = len(phone.answers)
            process = serve(tmp_path, port)
            ready(port, process)
        phone.restarted_after = before
        phone.join(120.0)
        # Whatever was answered is there.
        kept = httpx.get(f"{address}/sessions/{session}").json()
    finally:
        process.kill()
        process.wait()
    assert phone.log is not None
    assert phone.log.reconnects == 1
    frames = [answer.body["frame"] for answer in phone.answers]
    assert frames == sorted(set(frames))
    assert set(frames) <= {point["frame"] for point in kept["trajectory"]}
    after = phone.answers[before:]
    again = next(answer for answer in after if answer.body["located"])
    assert again.sent - after[0].sent <= FRAMES_TO_TRACKING
    assert all(answer.body["located"] for answer in after[-5:])
