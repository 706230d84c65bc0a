"""Guidance of sessions over HTTP: towards a destination, in a language, off the route, at the goal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from tests.api.test_sessions import send, start
from tests.plans import collection, landmark, link, put_features
from tests.scenes import Room, View, pose_at
from tests.server import Server, assert_problem, running

# Long enough to be led: from where the walker stands down a hall that begins in the scanned room.
FEATURES = collection(
    landmark("window", 1.6, 1.3),
    landmark("shelf", 2.4, 1.6),
    landmark("gate", 1.6, 9.0),
    landmark("island", 30.0, 30.0),
    link((1.6, 1.3), (2.4, 1.6), id="inside"),
    link((1.6, 1.3), (1.6, 9.0), id="out"),
)


def furnish(server: Server, venue: str) -> None:
    """Give a venue a ground floor whose plan is the world's, with landmarks."""
    body = {
        "name": "Ground",
        "level": 0,
        "z_min_m": -1.0,
        "z_max_m": 3.0,
        "plan_from_world": np.eye(4).tolist(),
    }
    assert server.client.put(f"/venues/{venue}/floors/ground", json=body).status_code == 200
    assert put_features(server, "ground", FEATURES, venue).status_code == 200


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with a mapped room whose plan is the world's, with landmarks."""
    with running(tmp_path_factory.mktemp("house"), run_worker=False) as server:
        server.add_venue("house")
        server.add_map(scan_zip, "house", gravity=[0, 0, -1])
        furnish(server, "house")
        yield server


@pytest.fixture(scope="module")
def video(room: Room) -> list[View]:
    """What a phone sees that is carried from the window to the shelf."""
    return [room.view(pose_at(1.6 + 0.02 * i, 1.35 + 0.01 * i, 1.45, -20 + 1.0 * i, 1.0)) for i in range(8)]


def guided(server: Server, view: View, **fields: str) -> dict[str, Any]:
    """Return the guidance of a new session's first frame."""
    found = send(server, start(server, "house", **fields), view, 0.0)
    assert found["located"], found
    return dict(found["guidance"])


def test_the_way_is_told_in_the_sessions_language(house: Server, video: list[View]) -> None:
    told = guided(house, video[0], destination="gate")
    assert (told["planned"], told["problem"], told["arrived"], told["off_route"]) == (
        True,
        None,
        False,
        False,
    )
    assert told["remaining_m"] == pytest.approx(7.65, abs=0.1)
    # The way goes along plan y, at 90 degrees; the camera looks to -20.
    assert told["instruction"].startswith("Turn left. Walk 8 m")
    assert told["bearing_deg"] == pytest.approx(110, abs=3)
    german = guided(house, video[0], destination="gate", language="de")
    assert german["instruction"] != told["instruction"]
    assert "8 m" in german["instruction"]
    assert {**german, "instruction": ""} == pytest.approx({**told, "instruction": ""}, abs=0.01)


def test_guidance_goes_on_and_follows_a_new_destination(house: Server, video: list[View]) -> None:
    session = start(house, "house", destination="gate")
    told = [send(house, session, view, i / 10)["guidance"] for i, view in enumerate(video[:3])]
    assert [one["planned"] for one in told] == [True, False, False]
    assert house.client.patch(f"/sessions/{session}", json={"destination": "shelf"}).status_code == 200
    there = send(house, session, video[3], 0.3)["guidance"]
    assert (there["planned"], there["arrived"], there["landmark"]) == (True, True, "shelf")
    assert there["instruction"] == "You have arrived at Shelf."
    assert house.client.patch(f"/sessions/{session}", json={"destination": None}).status_code == 200
    assert send(house, session, video[4], 0.4)["guidance"] is None


def test_who_is_lost_goes_on_as_told_and_then_stands_still(house: Server, video: list[View]) -> None:
    session = start(house, "house", destination="gate")
    send(house, session, video[0], 0.0)
    dark = View(video[1].world_from_camera, np.zeros_like(video[1].rgb), video[1].depth_m)
    told = [send(house, session, dark, time_s)["guidance"] for time_s in (0.5, 3.0, 30.0)]
    assert [one["problem"] for one in told] == ["lost", "lost", "lost"]
    # The way is straight for longer than anybody is sent on unseen.
    assert [one["go_on_m"] for one in told] == [4.0, 4.0, None]
    assert told[0]["instruction"].endswith("Go on as you were told.")
    assert told[2]["instruction"].startswith("Your place is not known. Stand still")


def test_who_was_never_seen_is_not_sent_on(house: Server, video: list[View]) -> None:
    dark = View(video[1].world_from_camera, np.zeros_like(video[1].rgb), video[1].depth_m)
    told = send(house, start(house, "house", destination="gate"), dark, 0.0)["guidance"]
    assert (told["problem"], told["go_on_m"]) == ("lost", None)


def test_who_leaves_the_route_gets_a_new_one(house: Server, video: list[View]) -> None:
    session = start(house, "house", destination="gate")
    assert not send(house, session, video[0], 0.0)["guidance"]["off_route"]
    # The ways move away under the walker's feet: what they follow is now far off.
    moved = collection(
        landmark("window", 1.6, 1.3), landmark("gate", 9.0, 1.3), link((1.6, 1.3), (9.0, 1.3), id="out")
    )
    sessions = cast(FastAPI, cast(TestClient, house.client).app).state.roomfix.services.sessions
    way = sessions._live.get(session).way
    far = [type(p)(p.floor, p.x + 20.0, p.y, p.along_m) for p in way.route.points]
    way.route = replace(way.route, points=tuple(far), passages=())
    assert put_features(house, "ground", moved, "house").status_code == 200
    try:
        told = [send(house, session, view, 0.1 + i / 10)["guidance"] for i, view in enumerate(video[1:6])]
    finally:
        assert put_features(house, "ground", FEATURES, "house").status_code == 200
    assert [one["off_route"] for one in told] == [True, True, True, False, False]
    assert told[0]["instruction"] == "You have left the route."
    assert told[3]["remaining_m"] == pytest.approx(7.4, abs=0.2)
    assert [one["planned"] for one in told] == [False, False, False, True, False]


def test_a_destination_without_a_way_is_a_problem_told(house: Server, video: list[View]) -> None:
    told = guided(house, video[0], destination="island")
    assert told["problem"] in ("no_route", "off_network")
    assert (told["instruction"], told["arrived"]) == (None, False)
    assert_problem(
        house.client.post("/sessions", json={"venue": "house", "destination": "moon"}), 404, "not_found"
    )
    assert_problem(
        house.client.post("/sessions", json={"venue": "house", "language": "fr"}), 422, "invalid_input"
    )


def test_a_route_from_where_a_session_is(house: Server, video: list[View]) -> None:
    session = start(house, "house")
    query = {"from": f"session:{session}", "to": "gate"}
    path = "/venues/house/route"
    assert_problem(house.client.get(path, params=query), 409, "conflict")
    send(house, session, video[0], 0.0)
    found = house.client.get(path, params=query).json()
    assert found["distance_m"] == pytest.approx(7.65, abs=0.1)
    assert found["landmarks"][-1] == "gate"
    with house.unchanged():
        assert_problem(
            house.client.get(path, params={"from": f"session:{'0' * 32}", "to": "gate"}), 404, "not_found"
        )
        assert_problem(
            house.client.get(path, params={"from": "session:../x", "to": "gate"}), 404, "not_found"
        )


def test_a_session_of_another_venue_has_no_place_here(house: Server, video: list[View]) -> None:
    session = start(house, "house")
    send(house, session, video[0], 0.0)
    house.add_venue("other")
    furnish(house, "other")
    answer = house.client.get("/venues/other/route", params={"from": f"session:{session}", "to": "gate"})
    assert "session" in assert_problem(answer, 404, "not_found")


def test_who_is_lost_is_told_what_to_do(house: Server, video: list[View]) -> None:
    session = start(house, "house", destination="gate")
    dark = View(video[0].world_from_camera, np.zeros_like(video[0].rgb), video[0].depth_m)
    for view, at_s in ((dark, 0.0), (video[0], 0.1), (dark, 30.0)):
        found = send(house, session, view, at_s)
        told = found["guidance"]
        if view is dark:
            assert (found["located"], told["problem"], told["arrived"]) == (False, "lost", False)
            known = "." if at_s else " yet."
            assert told["instruction"].startswith(f"Your place is not known{known} Stand still")
        else:
            assert told["problem"] is None
    assert send(house, start(house, "house"), dark, 0.0)["guidance"] is None
