"""A running server for tests: the real app with real migrations, SQLite, blobs and, if wanted, build worker."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import uvicorn
from fastapi import FastAPI
from fastapi.testclient import TestClient
from sqlalchemy import create_engine, select

from app.commands.serving.connections import connection_options
from app.geometry.se3 import Pose
from app.jobs.runner import BuildRunner, NoRunner
from app.main import create_app
from app.settings import Settings
from app.storage.db import Database
from app.storage.tables import metadata
from tests.built_maps import publish
from tests.ports import free_port
from tests.scenes import CAMERA_TEXT

# Options of a build that is done soon, since nothing is refined or registered.
QUICK = {"world_from_scan": np.eye(4).tolist(), "refine_depth": False}
ENDED = ("succeeded", "failed", "cancelled")
# Far beyond what a busy machine needs: only a test that fails waits as long.
WAIT_S = 180.0
# Between two checks of a build.
POLL_S = 0.1
# Of the files in the data folder these change without meaning anything.
IGNORED = ("roomfix.db", "worker.lock", "hold", "held")


class Server:
    """The contract's calls on a server, in this process or another."""

    def __init__(self, client: httpx.Client, data_dir: Path) -> None:
        self.client = client
        self.data_dir = data_dir

    def add_venue(self, venue: str) -> str:
        """Add a venue of that id."""
        assert self.client.post("/venues", json={"id": venue, "name": venue.title()}).status_code == 201
        return venue

    def submit(self, archive: bytes, venue: str, options: object = None) -> httpx.Response:
        """Post a scan; options default to the synthetic camera's, text is sent as it is."""
        chosen = {"camera": CAMERA_TEXT} if options is None else options
        text = chosen if isinstance(chosen, str) else json.dumps(chosen)
        return self.client.post(
            "/database/build",
            data={"venue": venue, "options": text},
            files={"archive": ("scan.zip", archive)},
        )

    @contextmanager
    def uploaded(self, data: bytes) -> Iterator[str]:
        """Send a file as an upload, give its id, and delete it."""
        tus = {"Tus-Resumable": "1.0.0"}
        begun = self.client.post("/uploads", headers={**tus, "Upload-Length": str(len(data))})
        url = begun.headers["location"]
        part = {**tus, "Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
        assert self.client.patch(url, content=data, headers=part).status_code == 204
        yield url.rsplit("/", 1)[-1]
        assert self.client.delete(url, headers=tus).status_code == 204

    def build(self, archive: bytes, venue: str, **options: object) -> dict[str, Any]:
        """Post a scan and return its build when it has ended and its archive is gone, which is a moment later."""
        answer = self.submit(archive, venue, {"camera": CAMERA_TEXT, **options})
        assert answer.status_code == 202, answer.text
        ended = self.wait(answer.json()["build"])
        digest = hashlib.sha256(archive).hexdigest()
        wait_for(lambda: not any(name.endswith(digest) for name in self.files()))
        return ended

    def add_map(self, archive: bytes, venue: str, **options: object) -> dict[str, Any]:
        """Give a venue the map of a scan as `build` does, but built once in a run of the tests; return its build.

        Without a worker, and for tests whose subject is not the build.
        """
        return self.add_maps(venue, (archive, options))

    def add_maps(self, venue: str, *scans: tuple[bytes, Mapping[str, object]]) -> dict[str, Any]:
        """The same with several scans, one after another: archives with their options.

        Without a second look, by which each refused picture of all tests would take a second longer.
        """
        shared = {"camera": CAMERA_TEXT, "second_features": False}
        full = [(archive, {**shared, **options}) for archive, options in scans]
        return self.status(publish(self.data_dir, venue, full))

    def status(self, build: str) -> dict[str, Any]:
        """Return a build."""
        answer = self.client.get(f"/database/builds/{build}")
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    def wait(self, build: str) -> dict[str, Any]:
        """Return a build once it has ended."""
        # Seldom: the server, which answers in this process, would take a third of a core from the worker.
        return wait_for(
            lambda: body if (body := self.status(build))["state"] in ENDED else None, pause_s=POLL_S
        )

    def post_image(self, image: bytes, fields: Mapping[str, str]) -> httpx.Response:
        """Post an image to /locate with just these fields."""
        return self.client.post("/locate", data=dict(fields), files={"image": ("photo.jpg", image)})

    def locate(self, image: bytes, **fields: str) -> dict[str, Any]:
        """Return the LocateResult of an image taken by the synthetic camera."""
        answer = self.post_image(image, {"camera": CAMERA_TEXT, **fields})
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    def files(self) -> set[str]:
        """Return every file in the data folder that matters: blobs and scratch."""
        # Not by `rglob`, which fails on folders that vanish under it.
        paths = (Path(folder, name) for folder, _, names in os.walk(self.data_dir) for name in names)
        names = (path.relative_to(self.data_dir).as_posix() for path in paths)
        return {name for name in names if not name.startswith(IGNORED)}

    def rows(self, *leave_out: str) -> dict[str, list[str]]:
        """Return every row of every table, but of those left out."""
        engine = create_engine(f"sqlite:///{self.data_dir / 'roomfix.db'}")
        with engine.connect() as connection:
            found = {
                table.name: sorted(repr(tuple(row)) for row in connection.execute(select(table)))
                for table in metadata.sorted_tables
                if table.name not in leave_out
            }
        engine.dispose()
        return found

    @contextmanager
    def unchanged(self, *leave_out: str) -> Iterator[None]:
        """Check that the block leaves all files, and all tables but those named, as they were."""
        files, rows = self.files(), self.rows(*leave_out)
        yield
        # A build has ended a moment before its archive is gone.
        wait_for(lambda: self.files() == files, 10.0)
        assert self.rows(*leave_out) == rows

    @contextmanager
    def unchanged_rows(self) -> Iterator[None]:
        """Check that the block leaves all tables as they were."""
        rows = self.rows()
        yield
        assert self.rows() == rows


@contextmanager
def running(data_dir: Path, runner: BuildRunner | None = None, **values: Any) -> Iterator[Server]:
    """Serve in this process, open unless an `admin_key` is given; the build worker is a process of its own."""
    settings = Settings(_env_file=None, data_dir=data_dir, open="admin_key" not in values, **values)
    path = data_dir / "roomfix.db"
    if "database_url" not in values and not path.exists():
        data_dir.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_migrated())
    with TestClient(create_app(settings, runner), base_url="http://127.0.0.1") as client:
        yield Server(client, data_dir)


@contextmanager
def listening(data_dir: Path, **values: Any) -> Iterator[tuple[str, FastAPI]]:
    """Serve on a port of loopback, open and without a worker, in a thread of this process; give its URL and the app."""
    port = free_port()
    app = create_app(Settings(_env_file=None, data_dir=data_dir, open=True, **values), NoRunner())
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error", **connection_options()))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        wait_for(lambda: server.started)
        yield f"http://127.0.0.1:{port}", app
    finally:
        server.should_exit = True
        thread.join()


@cache
def _migrated() -> bytes:
    """Return an SQLite file without rows on which all migrations ran."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "empty.db"
        database = Database(f"sqlite:///{path}")
        database.migrate()
        database.close()
        return path.read_bytes()


def wait_for(condition: Any, seconds: float = WAIT_S, pause_s: float = 0.02) -> Any:
    """Return what `condition` returns as soon as that is true; fail the test if it never is."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        if value := condition():
            return value
        time.sleep(pause_s)
    raise AssertionError(f"waited {seconds} s in vain")


def assert_problem(answer: httpx.Response, status: int, code: str | None = None) -> str:
    """Check that an answer is an RFC 9457 problem for people to act on, and return its sentence."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["x-request-id"]
    body = answer.json()
    assert body["status"] == status
    assert body["type"]
    assert body["title"]
    assert code is None or body["code"] == code, body
    assert_sentence(body["detail"])
    return str(body["detail"])


def assert_sentence(text: str) -> None:
    """Check that a message is for a person: one short paragraph without a trace of the machinery."""
    assert len(text) > 10
    assert len(text) < 500
    for trace in ("Traceback", "Error:", "Errno", ".py", "0x", "\n", "Unexpected"):
        assert trace not in text, text


def pose_errors(result: dict[str, Any], truth: Pose) -> tuple[float, float]:
    """Return the metres and degrees by which an answer is off."""
    p, q = result["pose"]["position"], result["pose"]["quaternion"]
    found = Pose.from_quaternion([p["x"], p["y"], p["z"]], [q["x"], q["y"], q["z"], q["w"]])
    turn = (found.rotation.T @ truth.rotation).trace()
    angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
    return float(np.linalg.norm(found.translation - truth.translation)), float(angle)
