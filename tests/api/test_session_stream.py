"""The stream of a session: the newest frame first, bad messages survived, one connection at a time."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, cast

import pytest
from fastapi import WebSocket
from fastapi.testclient import TestClient
from starlette.testclient import WebSocketDenialResponse, WebSocketDisconnect, WebSocketTestSession

from app.api.session_stream import Stream
from app.geometry.se3 import Pose
from tests.api.test_sessions import error_m, start
from tests.scenes import Room, View, pose_at
from tests.server import Server, running


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What a phone sees that is carried through the room."""
    return [room.view(pose_at(1.6 + 0.02 * i, 1.4 + 0.01 * i, 1.45, -20 + 1.5 * i, 1.0)) for i in range(20)]


@contextmanager
def connected(
    server: Server, session: str, query: str = "", protocols: list[str] | None = None
) -> Iterator[WebSocketTestSession]:
    assert isinstance(server.client, TestClient)
    with server.client.websocket_connect(
        f"ws://127.0.0.1/sessions/{session}/stream{query}", protocols
    ) as socket:
        yield socket


def sent(socket: WebSocketTestSession, view: View, time_s: float) -> dict[str, Any]:
    """Send a frame and return the answer."""
    socket.send_text(json.dumps({"timestamp": time_s}))
    socket.send_bytes(view.jpeg())
    return dict(socket.receive_json())


def test_each_frame_is_answered(museum: Server, video: list[View]) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        for i, view in enumerate(video[:6]):
            result = sent(socket, view, i / 10)
            assert (result["tracking"], result["received"], result["frame"]) == ("tracking", i + 1, i + 1)
            assert error_m(result, view) < 0.03
    # The session goes on with a new connection, or without any.
    with connected(museum, session) as socket:
        result = sent(socket, video[6], 0.6)
        assert (result["received"], result["frame"], result["tracking"]) == (1, 7, "tracking")


def test_of_many_waiting_frames_the_newest_is_answered(museum: Server, video: list[View]) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        for view in video:
            socket.send_bytes(view.jpeg())
        received = []
        while not received or received[-1] < len(video):
            received.append(socket.receive_json()["received"])
    assert received == sorted(set(received))
    assert len(received) < len(video)
    assert museum.client.get(f"/sessions/{session}").json()["frames"] == len(received)


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (b"not an image", "unsupported_image"),
        (b"", "invalid_image"),
        ("not json", "invalid_input"),
        ("[1, 2]", "invalid_input"),
        ('{"destination": "x"}', "invalid_input"),
        ('{"camera": {"\\ud800": 1}}', "invalid_input"),
        ("[" * 9_000, "invalid_input"),
        ("x" * 20_000, "invalid_input"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_bad_message_is_answered_and_the_stream_goes_on(
    museum: Server, video: list[View], message: str | bytes, code: str
) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        if isinstance(message, bytes):
            socket.send_bytes(message)
        else:
            socket.send_text(message)
        problem = socket.receive_json()
        assert (problem["code"], 400 <= problem["status"] < 500) == (code, True)
        assert "frame" not in problem
        assert sent(socket, video[0], 0.0)["tracking"] == "tracking"


@pytest.mark.parametrize(
    "hints",
    [{"motion": {}}, {"motion": 5}, {"timestamp": "x"}, {"camera": "1"}, {"gravity": [0, 0, 0]}],
    ids=str,
)
def test_bad_hints_cost_one_frame(museum: Server, video: list[View], hints: dict[str, Any]) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        socket.send_text(json.dumps(hints))
        socket.send_bytes(video[0].jpeg())
        assert socket.receive_json()["code"] in ("invalid_input", "invalid_camera")
        assert sent(socket, video[0], 0.0)["tracking"] == "tracking"


def test_a_hundred_megabytes_end_the_stream(museum: Server, video: list[View]) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        socket.send_bytes(bytes(100_000_000))
        assert socket.receive_json()["code"] == "image_too_large"
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
        assert closed.value.code == 1009
    with connected(museum, session) as socket:
        assert sent(socket, video[0], 0.0)["tracking"] == "tracking"


def test_a_second_connection_takes_the_session_over(museum: Server, video: list[View]) -> None:
    session = start(museum)
    with connected(museum, session) as first:
        assert sent(first, video[0], 0.0)["frame"] == 1
        with connected(museum, session) as second:
            assert sent(second, video[1], 0.1)["frame"] == 2
            with pytest.raises(WebSocketDisconnect) as closed:
                first.receive_json()
            assert closed.value.code == 4000
            assert sent(second, video[2], 0.2)["tracking"] == "tracking"


def test_a_session_that_ends_takes_its_stream_along(museum: Server, video: list[View]) -> None:
    session = start(museum)
    with connected(museum, session) as socket:
        sent(socket, video[0], 0.0)
        assert museum.client.delete(f"/sessions/{session}").status_code == 204
        socket.send_bytes(video[1].jpeg())
        assert socket.receive_json()["code"] == "not_found"
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
        assert closed.value.code == 4404


@pytest.mark.parametrize("session", ["0" * 32, "nonsense", "%00"])
def test_a_session_that_is_not_there_has_no_stream(museum: Server, session: str) -> None:
    with pytest.raises(WebSocketDenialResponse) as refused, connected(museum, session):
        pass
    assert (refused.value.status_code, refused.value.json()["code"]) == (404, "not_found")


def test_the_key_is_a_header_or_a_subprotocol(tmp_path_factory: pytest.TempPathFactory) -> None:
    with running(tmp_path_factory.mktemp("keyed"), run_worker=False, admin_key="secret") as server:
        server.client.headers["Authorization"] = "Bearer secret"
        server.add_venue("museum")
        session = start(server)
        with connected(server, session):
            pass
        del server.client.headers["Authorization"]
        with connected(server, session, protocols=["roomfix", "roomfix.key.secret"]) as socket:
            assert socket.accepted_subprotocol == "roomfix"
        for query, protocols in (("", None), ("?key=secret", None), ("", ["roomfix", "roomfix.key.wrong"])):
            with (
                pytest.raises(WebSocketDenialResponse) as refused,
                connected(server, session, query, protocols),
            ):
                pass
            assert refused.value.status_code == 401
            assert refused.value.headers["www-authenticate"] == 'Bearer realm="roomfix"'
            assert ("not taken from the address" in refused.value.json()["detail"]) == bool(query)


def motion_json(motion: Pose) -> str:
    """Return a motion hint."""
    position = dict(zip("xyz", motion.translation.tolist(), strict=True))
    quaternion = dict(zip("xyzw", motion.quaternion.tolist(), strict=True))
    return json.dumps({"motion": {"position": position, "quaternion": quaternion}})


def test_motion_of_skipped_frames_adds_up(video: list[View]) -> None:
    poses = [view.world_from_camera for view in video[:4]]
    stream = Stream(socket=cast(WebSocket, None), session="s")

    async def skip(hints: list[str]) -> Pose | None:
        for text in hints:
            stream.note_hints(text)
            stream.put(b"frame")
        return (await stream.take()).motion

    steps = [motion_json(a.inverse() @ b) for a, b in pairwise(poses)]
    motion = asyncio.run(skip(steps))
    assert motion is not None
    assert motion.matrix == pytest.approx((poses[0].inverse() @ poses[3]).matrix)
    assert stream.received == 3
    # One step that is not known leaves the sum unknown.
    assert asyncio.run(skip([steps[0], "{}", steps[2]])) is None
    assert asyncio.run(skip([steps[0]])) is not None
