"""While another program holds the database, a write is a 503 that says when to try again; everything else goes on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from app.storage import db
from tests.api.test_anchors import MONITOR, PHONE, anchor_body, down, push
from tests.api.test_sessions import post, send, start
from tests.locks import locked
from tests.plans import GROUND, collection, landmark
from tests.scenes import Room, View
from tests.server import Server, assert_problem, running

WAIT_S = 0.1


@pytest.fixture(scope="module")
def room() -> Room:
    """A room that no map holds."""
    return Room(seed=5)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, room: Room) -> Iterator[Server]:
    """A server that waits for a lock only a moment, with a venue, a floor, a session's room and an anchor."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(db, "OPTIONS", db.DatabaseOptions(lock_wait_s=WAIT_S))
        with running(tmp_path_factory.mktemp("locked"), run_worker=False) as server:
            server.add_venue("v")
            floor = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
            assert server.client.put("/venues/v/floors/0", json=floor).status_code == 200
            monitor = room.view(MONITOR)
            assert server.client.put("/anchors/hall", json=anchor_body(monitor)).status_code == 200
            assert push(server, "hall", monitor.png()).status_code == 200
            yield server


FLOOR = {"name": "Other", "level": 1, "z_min_m": 3, "z_max_m": 6}
WRITES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "a venue": ("POST", "/venues", {"json": {"id": "w", "name": "W"}}),
    "a venue's name": ("PATCH", "/venues/v", {"json": {"name": "W"}}),
    "a venue's end": ("DELETE", "/venues/v", {}),
    "a floor": ("PUT", "/venues/v/floors/1", {"json": FLOOR}),
    "features": ("PUT", "/venues/v/floors/0/features", {"json": collection(landmark("a", 1, 1))}),
    "a session": ("POST", "/sessions", {"json": {"venue": "v"}}),
    "an anchor's end": ("DELETE", "/anchors/hall", {}),
    "a build": ("POST", "/database/build", {"data": {"venue": "v"}, "files": {"archive": b"x"}}),
}


@pytest.mark.parametrize("name", WRITES)
def test_a_write_is_to_be_tried_again(server: Server, name: str) -> None:
    method, path, body = WRITES[name]
    # The archive of a build stays until the sweep, as after any build that could not be queued.
    with server.unchanged_rows(), locked(server.data_dir / "roomfix.db"):
        answer = server.client.request(method, path, **body)
        assert "Try again" in assert_problem(answer, 503, "database_busy")
        # Longer than for a full queue.
        assert int(answer.headers["retry-after"]) == 5


def test_reading_goes_on_and_writing_afterwards(server: Server) -> None:
    with locked(server.data_dir / "roomfix.db"):
        assert server.client.get("/venues").status_code == 200
        assert server.client.get("/readyz").status_code == 200
    assert server.client.put("/venues/v/floors/0/features", json=GROUND | {"features": []}).status_code == 200


def test_an_anchor_locates_though_its_use_is_not_counted(server: Server, room: Room) -> None:
    phone = room.view(PHONE)

    def uses() -> int:
        return int(server.client.get("/anchors/hall").json()["uses"])

    before = uses()
    with locked(server.data_dir / "roomfix.db"):
        assert server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone))["located"]
    assert uses() == before
    assert server.locate(phone.png(), venue="v", method="anchor", gravity=down(phone))["located"]
    assert uses() == before + 1


def test_a_frame_that_can_not_be_stored_has_not_been(server: Server, room: Room) -> None:
    views: list[View] = [room.view(PHONE), room.view(MONITOR)]
    session = start(server, "v")
    assert send(server, session, views[0], 0.0)["frame"] == 1
    with locked(server.data_dir / "roomfix.db"):
        refused = post(server, session, views[1].jpeg(), timestamp="0.1")
        assert_problem(refused, 503, "database_busy")
        assert int(refused.headers["retry-after"]) >= 1
    assert send(server, session, views[0], 0.2)["frame"] == 2
