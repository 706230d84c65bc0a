"""Sessions over HTTP: starting, changing and ending them, frames, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, cast

import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from sqlalchemy import create_engine, text

from app.services.sessions import _Live
from tests.scenes import CAMERA, CAMERA_TEXT, Room, View, pose_at, scan_files, zipped
from tests.server import Server, assert_problem, running

STOREY_M = 3.5


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What a phone sees that is carried through the room."""
    return [room.view(pose_at(1.6 + 0.02 * i, 1.4 + 0.01 * i, 1.45, -20 + 1.5 * i, 1.0)) for i in range(20)]


@pytest.fixture(scope="module")
def tower(museum: Server, scan_zip: bytes, foreign_room: Room, views: list[View]) -> str:
    """A venue with another room above the first one, each on its floor."""
    venue = museum.add_venue("tower")
    raised = np.eye(4)
    raised[2, 3] = STOREY_M
    upstairs = zipped(scan_files([foreign_room.view(view.world_from_camera) for view in views]))
    above = {"mode": "extend", "world_from_scan": raised.tolist()}
    museum.add_maps(venue, (scan_zip, {"gravity": [0, 0, -1]}), (upstairs, above))
    for level, floor in enumerate(("ground", "first")):
        body = {
            "name": floor,
            "level": level,
            "z_min_m": STOREY_M * level,
            "z_max_m": STOREY_M * level + 2.6,
            "plan_from_world": np.eye(4).tolist(),
        }
        assert museum.client.put(f"/venues/{venue}/floors/{floor}", json=body).status_code == 200
    return venue


def start(server: Server, venue: str = "museum", **fields: object) -> str:
    """Start a session and return its id."""
    answer = server.client.post("/sessions", json={"venue": venue, "camera": CAMERA_TEXT, **fields})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["session"])


def post(server: Server, session: str, image: bytes, **fields: str) -> httpx.Response:
    """Post a frame."""
    return server.client.post(f"/sessions/{session}/frames", files={"image": ("f.jpg", image)}, data=fields)


def send(server: Server, session: str, view: View, time_s: float, **fields: str) -> dict[str, Any]:
    """Post a frame and return its answer."""
    answer = post(server, session, view.jpeg(), timestamp=str(time_s), **fields)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def motion_text(x: float, w: float) -> str:
    """Return a motion hint: a way along x, and a quaternion whose only part is w."""
    return json.dumps({"position": {"x": x, "y": 0, "z": 0}, "quaternion": {"x": 0, "y": 0, "z": 0, "w": w}})


def error_m(result: dict[str, Any], view: View, storey: int = 0) -> float:
    """Return how far off a position is."""
    p = result["pose"]["position"]
    truth = view.world_from_camera.translation + np.array([0.0, 0.0, STOREY_M * storey])
    return float(np.linalg.norm(np.array([p["x"], p["y"], p["z"]]) - truth))


def test_a_video_is_tracked_and_its_trajectory_kept(museum: Server, tower: str, video: list[View]) -> None:
    session = start(museum, tower)
    for i, view in enumerate(video):
        result = send(museum, session, view, i / 10)
        assert (result["tracking"], result["located"], result["floor"]) == ("tracking", True, "ground")
        assert error_m(result, view) < 0.03
        assert (result["session"], result["frame"], result["venue"]) == (session, i + 1, tower)
        assert result["guidance"] is None
        assert [point["frame"] for point in result["trajectory"]][-1] == i + 1
        assert result["accuracy"]["position_m"] < 0.2
    body = museum.client.get(f"/sessions/{session}").json()
    assert (body["frames"], body["tracking"], len(body["trajectory"])) == (20, "tracking", 20)
    last = body["trajectory"][-1]
    assert (last["x"], last["y"]) == pytest.approx(video[-1].world_from_camera.translation[:2], abs=0.03)
    assert last["pose"] == result["pose"]
    short = museum.client.get(f"/sessions/{session}", params={"points": 3}).json()
    assert short["trajectory"] == body["trajectory"][-3:]


def test_a_session_is_changed_and_ended(museum: Server) -> None:
    venue = museum.add_venue("gallery")
    floor = {"name": "Ground", "level": 0, "z_min_m": 0, "z_max_m": 3, "plan_from_world": np.eye(4).tolist()}
    assert museum.client.put(f"/venues/{venue}/floors/0", json=floor).status_code == 200
    landmarks = [
        {
            "type": "Feature",
            "id": name,
            "geometry": {"type": "Point", "coordinates": [x, 1.0]},
            "properties": {"type": "landmark", "name": name.title()},
        }
        for name, x in (("entrance", 1.0), ("cafe", 3.0))
    ]
    features = {"type": "FeatureCollection", "features": landmarks}
    assert museum.client.put(f"/venues/{venue}/floors/0/features", json=features).status_code == 200
    session = start(museum, venue, destination="entrance", language="en")
    path = f"/sessions/{session}"
    body = museum.client.get(path).json()
    assert (body["destination"], body["language"], body["tracking"]) == ("entrance", "en", "initializing")
    changed = museum.client.patch(path, json={"destination": "cafe", "camera": list(CAMERA.params)}).json()
    assert (changed["destination"], changed["language"]) == ("cafe", "en")
    assert changed["camera"] == list(CAMERA.params)
    unknown = museum.client.patch(path, json={"destination": "nowhere"})
    assert_problem(unknown, 404, "not_found")
    assert_problem(museum.client.patch(path, json={"language": "tlh"}), 422)
    fx, fy, cx, cy = CAMERA.params[:4]
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    assert museum.client.patch(path, json={"camera": matrix}).json()["camera"] == [fx, fy, cx, cy]
    cleared = museum.client.patch(path, json={"destination": None, "camera": None}).json()
    assert (cleared["destination"], cleared["camera"]) == (None, None)
    assert museum.client.delete(path).status_code == 204
    for answer in (museum.client.get(path), museum.client.delete(path), museum.client.patch(path, json={})):
        assert "session" in assert_problem(answer, 404, "not_found")


def test_a_camera_that_was_searched_for_is_kept(museum: Server, room: Room) -> None:
    session = start(museum, camera=None)
    corner = room.view(pose_at(1.7, 1.4, 1.45, 28.0, 2.0))
    first = send(museum, session, corner, 0.0)
    assert (first["located"], first["camera"]["source"]) == (True, "search")
    second = send(museum, session, room.view(pose_at(1.71, 1.4, 1.45, 28.5, 2.0)), 0.1)
    assert second["camera"] == first["camera"]
    assert second["method"] == "odometry"
    # Turned to portrait the phone has another camera, which is searched for again; and nothing is made up.
    turned = View(corner.world_from_camera, np.rot90(corner.rgb).copy(), corner.depth_m)
    assert send(museum, session, turned, 0.2)["camera"] != first["camera"]


def test_up_by_lift_is_lost_and_then_found_on_the_other_floor(
    museum: Server, tower: str, foreign_room: Room, video: list[View]
) -> None:
    session = start(museum, tower)
    for i, view in enumerate(video[:4]):
        send(museum, session, view, i / 10)
    upstairs = [foreign_room.view(view.world_from_camera) for view in video[10:14]]
    results = [send(museum, session, view, 10.4 + i / 10) for i, view in enumerate(upstairs)]
    assert (results[0]["tracking"], results[0]["located"], results[0]["pose"]) == ("lost", False, None)
    assert results[0]["reason"] == "ambiguous"
    assert [(r["tracking"], r["floor"]) for r in results[1:]] == [
        ("relocalized", "first"),
        ("tracking", "first"),
        ("tracking", "first"),
    ]
    for result, view in zip(results[1:], upstairs[1:], strict=True):
        assert error_m(result, view, storey=1) < 0.05


def test_put_away_and_taken_out_elsewhere(museum: Server, tower: str, room: Room, video: list[View]) -> None:
    session = start(museum, tower)
    for i, view in enumerate(video[:4]):
        send(museum, session, view, i / 10)
    black = View(video[0].world_from_camera, np.zeros_like(video[0].rgb), video[0].depth_m)
    for i in range(3):
        result = send(museum, session, black, 0.4 + i / 10)
        assert (result["tracking"], result["located"], result["reason"]) == ("lost", False, "poor_image")
    elsewhere = [room.view(pose_at(2.5 + 0.02 * i, 1.8, 1.45, 60.0)) for i in range(3)]
    results = [send(museum, session, view, 10.5 + i / 10) for i, view in enumerate(elsewhere)]
    states = [result["tracking"] for result in results]
    assert "relocalized" in states[:2]
    assert states[2] == "tracking"
    for result, view in zip(results, elsewhere, strict=True):
        assert result["located"] is False or error_m(result, view) < 0.05


def test_the_phones_motion_comes_as_a_hint(museum: Server, video: list[View]) -> None:
    session = start(museum)
    send(museum, session, video[0], 0.0)
    step = video[0].world_from_camera.inverse() @ video[1].world_from_camera
    (x, y, z), (qx, qy, qz, qw) = step.translation, step.quaternion
    motion = {"position": {"x": x, "y": y, "z": z}, "quaternion": {"x": qx, "y": qy, "z": qz, "w": qw}}
    result = send(museum, session, video[1], 0.1, motion=json.dumps(motion), gravity="0,1,0")
    assert result["tracking"] == "tracking"


def test_a_venue_without_a_map_has_nothing_to_track_by(museum: Server, video: list[View]) -> None:
    session = start(museum, museum.add_venue("blank"))
    result = send(museum, session, video[0], 0.0)
    assert (result["tracking"], result["located"], result["reason"]) == ("initializing", False, "no_map")
    assert (result["pose"], result["map_version"]) == (None, None)


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"venue": "atlantis"}, 404),
        ({}, 422),
        ({"venue": "../etc"}, 422),
        ({"venue": "museum", "camera": "1,2"}, 422),
        ({"venue": "museum", "camera": [1e300, 1e300, 0, "x"]}, 422),
        ({"venue": "museum", "camera": {"model": "PINHOLE"}}, 422),
        ({"venue": "museum", "language": "en; drop table sessions"}, 422),
        ({"venue": "museum", "destination": "x" * 201}, 422),
    ],
    ids=str,
)
def test_a_session_that_can_not_be_started(museum: Server, body: dict[str, Any], status: int) -> None:
    with museum.unchanged_rows():
        assert_problem(museum.client.post("/sessions", json=body), status)


@pytest.mark.parametrize(
    ("image", "fields", "status"),
    [
        (b"", {}, 422),
        (b"not an image", {}, 415),
        (None, {"camera": "5,5,1,1"}, 422),
        (None, {"motion": "{}"}, 422),
        (None, {"motion": motion_text(1e9, 1.0)}, 422),
        (None, {"motion": motion_text(0.0, 0.0)}, 422),
        (None, {"motion": "[" * 10_000}, 422),
        (None, {"timestamp": "nan"}, 422),
        (None, {"timestamp": "soon"}, 422),
        (None, {"gravity": "0,0,0"}, 422),
    ],
    ids=lambda value: str(value)[:40],
)  # fmt: skip
def test_a_frame_that_can_not_be_used_changes_nothing(
    museum: Server, video: list[View], image: bytes | None, fields: dict[str, str], status: int
) -> None:
    session = start(museum)
    send(museum, session, video[0], 0.0)
    with museum.unchanged_rows():
        assert_problem(post(museum, session, video[1].jpeg() if image is None else image, **fields), status)
    assert send(museum, session, video[2], 0.2)["tracking"] == "tracking"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"timestamp": "1790000000000"}, "in milliseconds or nanoseconds"),
        ({"timestamp": "-1e300"}, "in milliseconds or nanoseconds"),
        ({"timestamp": "inf"}, "finite number of seconds"),
        ({"timestamp": "12,5"}, "such as 12.34"),
        ({"motion": motion_text(500.0, 1.0)}, "motion is 500 m long"),
    ],
    ids=str,
)
def test_hints_in_other_units_are_named(
    museum: Server, video: list[View], fields: dict[str, str], words: str
) -> None:
    session = start(museum)
    assert words in assert_problem(post(museum, session, video[0].jpeg(), **fields), 422)


def test_a_frame_without_an_image_or_of_no_session(museum: Server, video: list[View]) -> None:
    session = start(museum)
    assert_problem(museum.client.post(f"/sessions/{session}/frames", data={"timestamp": "1"}), 422)
    assert_problem(post(museum, "0" * 32, video[0].jpeg()), 404, "not_found")
    assert_problem(post(museum, "nonsense", video[0].jpeg()), 422)
    assert_problem(museum.client.patch(f"/sessions/{session}", json={"venue": "x"}), 422)


def test_two_frames_at_once_are_refused(museum: Server, video: list[View]) -> None:
    session = start(museum)
    assert isinstance(museum.client, TestClient)
    service = cast(FastAPI, museum.client.app).state.roomfix.services.sessions
    with service._live.get_or_make(session, _Live).lock:
        assert "stream" in assert_problem(post(museum, session, video[0].jpeg()), 409, "conflict")
    assert send(museum, session, video[0], 0.0)["frame"] == 1


def test_an_image_over_the_limit_is_refused(museum: Server) -> None:
    session = start(museum)
    assert_problem(post(museum, session, b"\xff\xd8" + bytes(30_000_000)), 413)


@pytest.fixture
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that asks for a key."""
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as server:
        yield server


def test_without_a_key_nothing(locked: Server) -> None:
    for call in ("get", "patch", "delete"):
        assert_problem(getattr(locked.client, call)(f"/sessions/{'0' * 32}"), 401, "unauthenticated")
    assert_problem(locked.client.post("/sessions", json={"venue": "x"}), 401)
    assert_problem(post(locked, "0" * 32, b"x"), 401)


def test_a_session_without_frames_for_long_expires(empty: Server) -> None:
    empty.add_venue("one")
    session = start(empty, "one")
    assert empty.client.get(f"/sessions/{session}").status_code == 200
    engine = create_engine(f"sqlite:///{empty.data_dir / 'roomfix.db'}")
    with engine.begin() as connection:
        connection.execute(text("UPDATE sessions SET active_at = '2020-01-01 00:00:00'"))
    assert "expired" in assert_problem(empty.client.get(f"/sessions/{session}"), 404)
    assert_problem(post(empty, session, b"x"), 404)
    start(empty, "one")
    with engine.begin() as connection:
        assert connection.execute(text("SELECT count(*) FROM sessions")).scalar() == 1
    engine.dispose()


def test_a_venue_takes_its_sessions_along(empty: Server) -> None:
    empty.add_venue("one")
    session = start(empty, "one")
    assert empty.client.delete("/venues/one").status_code == 204
    assert_problem(empty.client.get(f"/sessions/{session}"), 404)


def test_only_the_newest_points_are_kept(tmp_path_factory: pytest.TempPathFactory, video: list[View]) -> None:
    with running(
        tmp_path_factory.mktemp("short"), run_worker=False, session_trajectory_points=10, session_live_max=1
    ) as server:
        server.add_venue("one")
        session, other = start(server, "one"), start(server, "one")
        for i in range(12):
            # Two sessions take turns, where one may be held in memory.
            assert send(server, session, video[0], i / 10)["frame"] == i + 1
            assert send(server, other, video[0], i / 10)["frame"] == i + 1
        points = server.client.get(f"/sessions/{session}").json()["trajectory"]
        assert [point["frame"] for point in points] == list(range(3, 13))
