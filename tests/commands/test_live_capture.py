"""Cameras on the network and their newest pictures, from the stream to the anchor; and streams that break."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.commands import backoff, push_frames
from app.commands.live_capture import LiveCapture
from app.errors import InvalidInputError
from tests.api.test_anchors import SHIFT, anchor_body
from tests.scenes import Room, View, encode, pose_at
from tests.server import running, wait_for
from tests.streams import Camera, mjpeg_stream, rtsp_stream

Stream = Callable[[Camera], AbstractContextManager[str]]


@cache
def monitor() -> View:
    """Return what the monitoring camera sees."""
    return Room(seed=5).view(pose_at(1.2, 1.5, 2.2, 0.0, -12.0))


@cache
def phone() -> View:
    """Return what a phone sees."""
    return Room(seed=5).view(pose_at(1.7, 1.15, 1.4, 12.0, 2.0))


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing wait for seconds."""
    monkeypatch.setattr(backoff, "OPTIONS", backoff.BackoffOptions(first_s=0.05))


@pytest.fixture
def camera() -> Camera:
    """A camera that shows the room."""
    return Camera(monitor().jpeg())


def grey(level: int) -> bytes:
    """Return a JPEG file of one grey."""
    return encode(np.full((240, 320, 3), level, np.uint8), ".jpg")


def level_of(image: np.ndarray) -> float:
    return float(image.mean())


@pytest.mark.parametrize("stream", [rtsp_stream, mjpeg_stream])
def test_a_stream_becomes_an_anchors_frame_and_locates_a_phone(
    stream: Stream, camera: Camera, tmp_path: Path
) -> None:
    with stream(camera) as url, running(tmp_path, run_worker=False) as server:
        server.add_venue("v")
        floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
        server.client.put("/venues/v/floors/0", json=floor)
        server.client.put("/anchors/hall", json=anchor_body(monitor()))
        frames = push_frames.open_frames(url)
        push_frames.send(server.client, "hall", next(frames), lambda: next(frames))
        close(frames)
        frame = server.client.get("/anchors/hall").json()["frame"]
        assert frame["fresh"]
        assert frame["pois_visible"] == ["poi"]
        found = server.locate(phone().png(), venue="v", method="anchor", gravity=gravity(phone()))
        assert found["located"], found
        at = np.array([found["plan"]["x"], found["plan"]["y"]]) - SHIFT
        assert np.linalg.norm(at - phone().world_from_camera.translation[:2]) < 0.15


def gravity(view: View) -> str:
    down = view.world_from_camera.rotation.T @ [0.0, 0.0, -1.0]
    return ",".join(f"{value:.4f}" for value in down)


def close(frames: Iterator[bytes]) -> None:
    """Stop reading a stream."""
    frames.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("stream", [rtsp_stream, mjpeg_stream])
def test_what_is_taken_is_the_newest_picture(stream: Stream, camera: Camera) -> None:
    camera.jpeg = grey(60)
    with stream(camera) as url:
        capture = LiveCapture(url)
        assert abs(level_of(capture.take()) - 60) < 3
        camera.jpeg = grey(200)
        # Pictures that were on their way may come first; those that were left unread don't queue up behind them.
        wait_for(lambda: level_of(capture.take()) > 190, 5.0)
        capture.close()


@pytest.mark.parametrize("stream", [rtsp_stream, mjpeg_stream])
def test_a_stream_that_breaks_is_opened_again(
    stream: Stream, camera: Camera, capsys: pytest.CaptureFixture[str]
) -> None:
    camera.jpeg = grey(60)
    with stream(camera) as url:
        capture = LiveCapture(url)
        capture.take()
        camera.broken.set()
        before = camera.clients
        wait_for(lambda: camera.clients >= before + 2, 20.0)
        camera.jpeg = grey(200)
        camera.broken.clear()
        wait_for(lambda: level_of(capture.take()) > 190, 20.0)
        capture.close()
    assert "opening it again" in capsys.readouterr().err


def test_a_camera_that_is_not_there_is_named() -> None:
    for absent in ("97", "rtsp://127.0.0.1:9/none", "http://127.0.0.1:9/none.mjpg"):
        with pytest.raises(InvalidInputError, match="can be opened") as refused:
            push_frames.open_frames(absent)
        assert str(refused.value).startswith(absent)


def test_a_picture_that_was_taken_is_not_taken_again(camera: Camera, tmp_path: Path) -> None:
    path = str(tmp_path / "few.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (320, 240))
    for level in (60, 200):
        writer.write(np.full((240, 320, 3), level, np.uint8))
    writer.release()
    frames = push_frames.open_frames(path)
    # A recording that ends is played again.
    levels = [level_of(cv2.imdecode(np.frombuffer(next(frames), np.uint8), 1)) for _ in range(3)]
    close(frames)
    assert all(min(abs(level - 60), abs(level - 200)) < 5 for level in levels)
