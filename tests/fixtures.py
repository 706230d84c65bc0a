"""What tests of several rooms share: the synthetic scan, and servers that hold its map or nothing."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator

import pytest

from app.commands.console import console
from tests.built_maps import FOLDER_VARIABLE
from tests.scenes import Room, View, query_poses, scan_files, walk, zipped
from tests.server import Server, running

_folders: list[str] = []


def pytest_configure() -> None:
    """Make the folder for built maps, which the processes that share the tests inherit."""
    if FOLDER_VARIABLE not in os.environ:
        _folders.append(tempfile.mkdtemp(prefix="roomfix-maps-"))
        os.environ[FOLDER_VARIABLE] = _folders[0]


def pytest_unconfigure() -> None:
    """Remove it, in the process that made it."""
    while _folders:
        os.environ.pop(FOLDER_VARIABLE, None)
        shutil.rmtree(_folders.pop(), ignore_errors=True)


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
        server.add_map(scan_zip, "museum", gravity=[0, 0, -1])
        yield server


@pytest.fixture(scope="session")
def leaning(tmp_path_factory: pytest.TempPathFactory, scan_zip: bytes) -> Iterator[Server]:
    """A server with the venue `leaning`: the scan's map, of which nothing says which way is up."""
    with running(tmp_path_factory.mktemp("leaning"), run_worker=False) as server:
        server.add_venue("leaning")
        server.add_map(scan_zip, "leaning")
        yield server


@pytest.fixture(scope="session")
def emptied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The server of `empty`."""
    with running(tmp_path_factory.mktemp("empty"), run_worker=False) as server:
        yield server


@pytest.fixture
def empty(emptied: Server) -> Iterator[Server]:
    """A server without venues, keys and a worker: what a test leaves there is deleted after it."""
    headers = emptied.client.headers.copy()
    yield emptied
    emptied.client.headers = headers
    for kind in ("venues", "keys"):
        for each in emptied.client.get(f"/{kind}").json():
            emptied.client.delete(f"/{kind}/{each['id']}")
    assert emptied.client.get("/venues").json() == []
