"""Sessions over HTTP."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scenes import CAMERA_TEXT, Room, View, pose_at
from tests.server import Server


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What a phone sees that is carried through the room."""
    return [room.view(pose_at(1.6 + 0.02 * i, 1.4 + 0.01 * i, 1.45, -20 + 1.5 * i, 1.0)) for i in range(20)]


def start(server: Server, **fields: object) -> str:
    answer = server.client.post("/sessions", json={"venue": "museum", "camera": CAMERA_TEXT, **fields})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["session"])


def test_a_video_is_tracked(museum: Server, video: list[View]) -> None:
    session = start(museum)
    for i, view in enumerate(video):
        answer = museum.client.post(
            f"/sessions/{session}/frames", files={"image": view.jpeg()}, data={"timestamp": str(i / 10)}
        )
        assert answer.status_code == 200, answer.text
        result = answer.json()
        assert result["tracking"] == "tracking"
        p = result["pose"]["position"]
        assert np.linalg.norm(np.array([p["x"], p["y"], p["z"]]) - view.world_from_camera.translation) < 0.03
    print(result)


def test_a_stream_answers_frames(museum: Server, video: list[View]) -> None:
    session = start(museum)
    client = museum.client
    with client.websocket_connect(f"/sessions/{session}/stream") as socket:  # type: ignore[attr-defined]
        for i, view in enumerate(video[:5]):
            socket.send_text('{"timestamp": %f}' % (i / 10))
            socket.send_bytes(view.jpeg())
            result = socket.receive_json()
            assert result["tracking"] == "tracking"
            assert result["received"] == i + 1
