"""What the check after a kill calls wrong: each kind of loss is seen, and a right state is not."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bench.kills.checking import Place, check
from bench.kills.clients import VENUE, Acknowledged, Sent
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
from tests.server import QUICK, Server, running


@pytest.fixture(scope="module")
def sent(views: list[View]) -> Sent:
    return Sent(scan=b"", options="{}", picture=views[2].jpeg(), camera=CAMERA_TEXT)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Iterator[Server]:
    """A server with a map, whose worker does not run."""
    with running(tmp_path_factory.mktemp("data"), run_worker=False) as server:
        server.add_venue(VENUE)
        server.add_map(zipped(scan_files(views[:4])), VENUE, **QUICK)
        yield server


def test_what_is_there_is_not_wrong(server: Server, sent: Sent) -> None:
    session = server.client.post("/sessions", json={"venue": VENUE}).json()["session"]
    builds = {each["build"] for each in server.client.get("/database/builds").json()}
    kept = Acknowledged(builds=builds, names={VENUE: VENUE.title()}, sessions={session: 0})
    place = Place()
    assert check(server.client, kept, sent, place) == []
    assert place.position is not None


@pytest.mark.parametrize(
    ("kept", "word"),
    [
        (Acknowledged(builds={"gone"}), "build gone is gone"),
        (Acknowledged(names={VENUE: "other"}), "not 'other'"),
        (Acknowledged(sessions={"gone": 1}), "session gone has lost frames"),
        (Acknowledged(headings_deg={"gone": 1.0}), "anchor gone has lost its change"),
        (Acknowledged(frames={"gone": "2026-01-01"}), "anchor gone has lost its frame"),
    ],
    ids=["build", "name", "session", "anchor", "frame"],
)
def test_each_loss_is_seen(server: Server, sent: Sent, kept: Acknowledged, word: str) -> None:
    (found,) = check(server.client, kept, sent, Place())
    assert word in found


def test_a_picture_that_is_elsewhere_is_wrong(server: Server, sent: Sent) -> None:
    (found,) = check(server.client, Acknowledged(), sent, Place([0.0, 0.0, 0.0]))
    assert "the picture is at" in found
