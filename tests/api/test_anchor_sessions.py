"""Sessions that a monitoring camera starts, in a venue that has no map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.api.test_anchors import MONITOR, SHIFT, anchor_body, down, poi, push
from tests.plans import area, collection
from tests.scenes import CAMERA_TEXT, Room, View, pose_at
from tests.server import Server, running

FPS = 10.0


@pytest.fixture(scope="module")
def room() -> Room:
    """A room that no map holds."""
    return Room(seed=5)


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What a phone sees that is carried through the room."""
    return [room.view(pose_at(1.7 + 0.03 * i, 1.15 + 0.005 * i, 1.4, 12.0 - 0.5 * i, 2.0)) for i in range(24)]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, room: Room) -> Iterator[Server]:
    """A server with a floor and a monitoring camera with three POIs, whose frame has come."""
    with running(tmp_path_factory.mktemp("anchor-sessions"), run_worker=False) as running_server:
        running_server.add_venue("v")
        floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
        assert running_server.client.put("/venues/v/floors/0", json=floor).status_code == 200
        monitor = room.view(MONITOR)
        pois = [poi(monitor, 170, 110), poi(monitor, 90, 120, "left"), poi(monitor, 240, 130, "right")]
        body = anchor_body(monitor, pois=pois)
        assert running_server.client.put("/anchors/hall", json=body).status_code == 200
        assert push(running_server, "hall", monitor.png()).status_code == 200
        yield running_server


def follow(server: Server, video: list[View], **session: Any) -> list[dict[str, Any]]:
    """Send a video to a new session and return its answers."""
    started = server.client.post("/sessions", json={"venue": "v", "camera": CAMERA_TEXT, **session})
    assert started.status_code == 201, started.text
    answers = []
    for i, view in enumerate(video):
        fields = {"timestamp": str(i / FPS), "gravity": down(view)}
        files = {"image": ("f.jpg", view.jpeg())}
        answer = server.client.post(f"/sessions/{started.json()['session']}/frames", files=files, data=fields)
        assert answer.status_code == 200, answer.text
        answers.append(answer.json())
    return answers


def off_m(answer: dict[str, Any], view: View) -> float:
    """Return how far off a point on the plan is."""
    x, y = view.world_from_camera.translation[:2] + SHIFT
    return float(np.hypot(answer["plan"]["x"] - x, answer["plan"]["y"] - y))


def test_a_session_starts_by_an_anchor_alone_and_odometry_keeps_its_scale(
    server: Server, video: list[View]
) -> None:
    answers = follow(server, video)
    first, last = answers[0], answers[-1]
    assert first["located"], first["reason"]
    assert (first["method"], first["anchors"], first["vertical"]) == ("anchor", ["hall"], "gravity")
    assert first["pose"] is None
    assert {answer["tracking"] for answer in answers} == {"tracking"}
    assert last["method"] == "odometry"
    assert last["anchors"] == []
    for answer, view in zip(answers, video, strict=True):
        assert off_m(answer, view) < 3 * answer["accuracy"]["position_m"]
    known_m = np.linalg.norm(
        (video[-1].world_from_camera.translation - video[0].world_from_camera.translation)[:2]
    )
    tracked_m = np.hypot(*(last["plan"][axis] - first["plan"][axis] for axis in "xy"))
    assert tracked_m == pytest.approx(known_m, rel=0.05)
    assert last["accuracy"]["position_m"] > first["accuracy"]["position_m"]


def test_on_a_floor_with_a_place_in_the_world_it_has_a_pose(server: Server, video: list[View]) -> None:
    matrix = np.eye(4)
    matrix[:2, 3] = SHIFT
    floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
    placed = server.client.put("/venues/v/floors/0", json={**floor, "plan_from_world": matrix.tolist()})
    assert placed.status_code == 200
    answer = follow(server, video[:2])[1]
    position = np.array([answer["pose"]["position"][axis] for axis in "xyz"])
    assert np.linalg.norm(position - video[1].world_from_camera.translation) < 0.2
    assert answer["floor"] == "0"
    assert server.client.put("/venues/v/floors/0", json=floor).status_code == 200


def test_on_a_plan_it_goes_on_where_no_anchor_sees_it_and_flow_loses_it(server: Server, room: Room) -> None:
    x, y = SHIFT
    walls = collection(area("room", x, y, x + room.size_m[0], y + room.size_m[1]))
    assert server.client.put("/venues/v/floors/0/features", json=walls).status_code == 200
    # A turn to the wall behind the monitoring camera, with a leap of three frames in the middle of it, and back a way.
    steps = [step for step in range(30) if step not in (14, 15, 16)]
    poses = [pose_at(1.7 + 0.04 * step, 1.15 + 0.02 * step, 1.4, 12.0 - 6.0 * step, 2.0) for step in steps]
    video = [room.view(pose) for pose in poses]
    answers = follow(server, video)
    # A place is answered once a second look has found it again.
    assert [answer["tracking"] for answer in answers[:3]] == ["initializing", "initializing", "tracking"]
    answers, video = answers[2:], video[2:]
    assert {answer["tracking"] for answer in answers} == {"tracking"}
    assert not answers[-1]["anchors"]
    assert answers[-1]["unaided_m"] > 0.5
    errors_m = [off_m(answer, view) for answer, view in zip(answers, video, strict=True)]
    assert all(
        error_m < max(0.2, 3 * answer["accuracy"]["position_m"])
        for error_m, answer in zip(errors_m, answers, strict=True)
    )
    assert max(errors_m) < 0.4
    assert server.client.put("/venues/v/floors/0/features", json=collection()).status_code == 200


def test_on_a_plan_a_walk_that_sees_nothing_for_a_second_is_lost_until_an_anchor_sees_it_twice(
    server: Server, video: list[View]
) -> None:
    x, y = SHIFT
    walls = collection(area("room", x - 9.0, y - 9.0, x + 9.0, y + 9.0))
    assert server.client.put("/venues/v/floors/0/features", json=walls).status_code == 200
    blank = replace(video[4], rgb=np.full_like(video[4].rgb, 128))
    unseen = round(1.0 * FPS) + 2
    answers = follow(server, [*video[:5], *[blank] * unseen, *video[5:11]])
    assert answers[4]["tracking"] == "tracking"
    lost = answers[5 + unseen - 1]
    assert (lost["located"], lost["tracking"], lost["reason"]) == (False, "lost", "no_match")
    last = answers[-1]
    assert last["located"], last["reason"]
    assert off_m(last, video[10]) < 3 * last["accuracy"]["position_m"]
    assert "relocalized" in {answer["tracking"] for answer in answers[5 + unseen :]}
    assert server.client.put("/venues/v/floors/0/features", json=collection()).status_code == 200


def test_without_a_camera_or_in_another_room_it_does_not_start(server: Server, video: list[View]) -> None:
    without = follow(server, video[:1], camera=None)[0]
    assert (without["located"], without["tracking"]) == (False, "initializing")
    strange = follow(server, [Room(seed=77).view(view.world_from_camera) for view in video[:2]])
    assert [answer["tracking"] for answer in strange] == ["initializing", "initializing"]
    assert strange[0]["plan"] is None


def test_a_floor_that_ends_below_the_phone_is_no_place(server: Server, video: list[View]) -> None:
    matrix = np.eye(4)
    low = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": -0.5, "plan_from_world": matrix.tolist()}
    assert server.client.put("/venues/v/floors/0", json=low).status_code == 200
    answer = follow(server, video[:1])[0]
    assert (answer["located"], answer["reason"]) == (False, "outside_venue")
    floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
    assert server.client.put("/venues/v/floors/0", json=floor).status_code == 200
