"""Frames that a build left out: counted by reason, with small pictures, which go with the version."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import cv2
import numpy as np
import pytest

from app.storage.sweep import sweep_blobs
from tests import scenes
from tests.faulty_scan import BLURRED, WITHOUT_DEPTH, faulty_scan
from tests.server import QUICK, Server, assert_problem, running


@pytest.fixture(scope="module")
def faulty(views: list[scenes.View]) -> bytes:
    """The archive of a scan with frames of both kinds; each thing that is left out is left out for one reason."""
    return scenes.zipped(faulty_scan(views))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, faulty: bytes) -> Iterator[Server]:
    """A server with the map of that scan in the venue `house`."""
    with running(tmp_path_factory.mktemp("left-out")) as server:
        server.add_venue("house")
        server.add_map(faulty, "house", **QUICK)
        yield server


def left_out(server: Server, venue: str = "house", version: int = 1) -> dict[str, Any]:
    answer = server.client.get(f"/venues/{venue}/maps/{version}/left-out")
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_frames_are_counted_by_reason(server: Server) -> None:
    found = left_out(server)
    (version,) = server.client.get("/venues/house/maps").json()
    assert found["frames"] == version["statistics"]["frames"] == len(scenes.walk())
    assert found["left_out"] == len(BLURRED) + len(WITHOUT_DEPTH)
    assert [(group["reason"], group["frames"]) for group in found["groups"]] == [
        ("no_depth", len(WITHOUT_DEPTH)),
        ("blurred", len(BLURRED)),
    ]
    assert found["groups"][1]["names"] == [f"rgb/{row / 10:.6f}.png" for row in BLURRED]
    assert found["replaced"] == len(version["statistics"]["replaced"])


def test_pictures_are_evenly_chosen_and_small(server: Server, views: list[scenes.View]) -> None:
    no_depth, blurred = left_out(server)["groups"]
    rows = [round(10 * float(each["name"][4:-4])) for each in no_depth["pictures"]]
    assert rows == [2, 3, 6, 7, 11, 12]
    assert [each["picture"] for each in (*no_depth["pictures"], *blurred["pictures"])] == list(range(8))
    # What was read has its time, what was not has its name alone.
    assert [each["time_s"] for each in no_depth["pictures"]] == [None] * 6
    assert [each["time_s"] for each in blurred["pictures"]] == [row / 10 for row in BLURRED]
    for row, each in zip(rows, no_depth["pictures"], strict=True):
        answer = server.client.get(f"/venues/house/maps/1/left-out/{each['picture']}")
        assert answer.headers["content-type"] == "image/jpeg"
        assert len(answer.content) < 40_000
        shown = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert shown.shape == (180, 240, 3)
        expected = cv2.resize(views[row].rgb, (240, 180), interpolation=cv2.INTER_AREA)
        assert np.abs(shown.astype(int) - expected).mean() < 12


def test_a_picture_that_the_client_has_is_not_sent_again(server: Server) -> None:
    path = "/venues/house/maps/1/left-out/0"
    first = server.client.get(path)
    again = server.client.get(path, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert server.client.get(path, headers={"If-None-Match": '"other"'}).content == first.content


def test_what_is_not_there_is_a_404(server: Server) -> None:
    for path in (
        *(f"none/maps/1/left-out{end}" for end in ("", "/0")),
        *(f"house/maps/99/left-out{end}" for end in ("", "/0")),
        "house/maps/1/left-out/8",
    ):
        assert_problem(server.client.get(f"/venues/{path}"), 404, "not_found")


@pytest.mark.parametrize("number", ["-1", "1.5", "99999999999999999999", "one", "%00", "0?width=1"])
def test_hostile_numbers_are_refused(server: Server, number: str) -> None:
    with server.unchanged():
        answer = server.client.get(f"/venues/house/maps/1/left-out/{number}")
        assert_problem(answer, 422, "invalid_request")


def test_a_scan_of_good_frames_has_left_nothing_out(server: Server, views: list[scenes.View]) -> None:
    server.add_venue("good")
    server.add_map(scenes.zipped(scenes.scan_files(views[:12])), "good", **QUICK)
    expected = {"frames": 12, "left_out": 0, "replaced": 0, "groups": []}
    assert left_out(server, "good") == expected


@pytest.fixture(scope="module")
def elsewhere(foreign_room: scenes.Room) -> bytes:
    """The archive of a scan with a frame without depth, whose pictures no other venue has."""
    views = [foreign_room.view(pose) for pose in scenes.walk()[:6]]
    return scenes.zipped(faulty_scan(views, (), (1,)))


def test_a_map_without_pictures_keeps_none_of_what_was_left_out(server: Server, elsewhere: bytes) -> None:
    server.add_venue("plain")
    before = server.files()
    server.add_map(elsewhere, "plain", store_images=False, **QUICK)
    (group,) = left_out(server, "plain")["groups"]
    assert (group["reason"], group["frames"], group["pictures"]) == ("no_depth", 1, [])
    assert_problem(server.client.get("/venues/plain/maps/1/left-out/0"), 404, "not_found")
    # The map's two files are all that was stored.
    assert len(set(server.files()) - set(before)) == 2


def test_pictures_go_with_their_version(server: Server, faulty: bytes) -> None:
    server.add_venue("twice")
    server.add_maps("twice", (faulty, QUICK), (faulty, {**QUICK, "features": "orb"}))
    resources = server.client.app.state.roomfix.services.resources  # type: ignore[attr-defined]
    shown = [server.client.get(f"/venues/twice/maps/2/left-out/{row}").content for row in range(8)]
    assert server.client.delete("/venues/twice/maps/1").status_code == 204
    assert_problem(server.client.get("/venues/twice/maps/1/left-out"), 404, "not_found")
    sweep_blobs(resources.database, resources.blobs, timedelta(0))
    # The version beside it has the same pictures still.
    again = [server.client.get(f"/venues/twice/maps/2/left-out/{row}").content for row in range(8)]
    assert again == shown


def test_a_deleted_venue_takes_its_pictures_along(server: Server, elsewhere: bytes) -> None:
    before = server.files()
    server.add_venue("short")
    server.add_map(elsewhere, "short", **QUICK)
    picture = server.client.get("/venues/short/maps/1/left-out/0").content
    digest = hashlib.sha256(picture).hexdigest()
    assert any(name.endswith(digest) for name in server.files())
    assert server.client.delete("/venues/short").status_code == 204
    assert not any(name.endswith(digest) for name in server.files())
    assert set(server.files()) == set(before)


def test_both_calls_ask_for_the_key(tmp_path_factory: pytest.TempPathFactory) -> None:
    with running(tmp_path_factory.mktemp("locked"), run_worker=False, admin_key="secret") as locked:
        for end in ("", "/0"):
            answer = locked.client.get(f"/venues/house/maps/1/left-out{end}")
            assert_problem(answer, 401, "unauthenticated")
