"""What tests of several rooms share: the synthetic scan, and servers that hold its map or nothing."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from app.commands.console import console
from tests.scenes import Room, View, query_poses, scan_files, walk, zipped
from tests.server import Server, running


@pytest.fixture(scope="session", autouse=True)
def _wide_console() -> None:
    """Let no printed table break its cells, whatever `COLUMNS` was when the console was made."""
    console.width = 400


@pytest.fixture(scope="session")
def room() -> Room:
    """The room of the scan."""
    return Room(seed=1)


@pytest.fixture(scope="session")
def foreign_room() -> Room:
    """A room of the same size that no map holds."""
    return Room(seed=2)


@pytest.fixture(scope="session")
def views(room: Room) -> list[View]:
    """The frames of the scan."""
    return [room.view(pose) for pose in walk()]


@pytest.fixture(scope="session")
def queries(room: Room) -> list[View]:
    """Pictures of the room from places between those of the scan."""
    return [room.view(pose) for pose in query_poses()]


@pytest.fixture(scope="session")
def scan_zip(views: list[View]) -> bytes:
    """The scan's archive."""
    return zipped(scan_files(views))


@pytest.fixture(scope="session")
def museum(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with a worker and the venue `museum`, whose map is the scan's. Tests leave that venue as it is."""
    with running(tmp_path_factory.mktemp("museum")) as server:
        server.add_venue("museum")
        assert server.build(scan_zip, "museum", gravity=[0, 0, -1])["state"] == "succeeded"
        yield server


@pytest.fixture(scope="session")
def leaning(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with the venue `leaning`: the scan's map, of which nothing says which way is up."""
    with running(tmp_path_factory.mktemp("leaning")) as server:
        server.add_venue("leaning")
        assert server.build(scan_zip, "leaning")["state"] == "succeeded"
        yield server


@pytest.fixture
def empty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server without venues and without a worker."""
    with running(tmp_path_factory.mktemp("empty"), run_worker=False) as server:
        yield server
