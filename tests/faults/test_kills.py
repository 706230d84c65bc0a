"""Kills at random moments: nothing acknowledged is lost, each build is done once, and it serves.

Clients build, edit, push frames of anchors and walk sessions meanwhile. `FAULTS` in the environment is the number of
kills; `make faults` sets a large one. Every moment comes from a seed.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from app.storage.blobs import BlobStore
from app.storage.check import check_store
from app.storage.db import Database
from bench.postgres import is_installed, postgres
from tests.jobs.live_server import SLOW_WORKER
from tests.jobs.test_kill import _is_ready, children
from tests.ports import free_port
from tests.scenes import CAMERA_TEXT, View, scan_files, zipped
from tests.server import ENDED, POLL_S, WAIT_S, Server, pose_errors, wait_for

KILLS = int(os.environ.get("FAULTS", "3"))
VENUE = "v"
FLOOR = {"name": "Ground", "level": 0, "z_min_m": -1, "z_max_m": 3}
ANCHOR = {
    "floor": "0",
    "position": {"x": 1, "y": 1},
    "height_m": 2,
    "camera": CAMERA_TEXT,
    "pois": [
        {
            "id": "sign",
            "region_px": [[10, 10], [60, 10], [60, 60], [10, 60]],
            "position": {"x": 3, "y": 1},
            "distance_m": 2.5,
        }
    ],
}
# Servers and their addresses.
Processes = list[tuple[subprocess.Popen[bytes], str]]
# From the start of the work until the kill.
MOST_S = 4.0


@dataclass
class Acknowledged:
    """What the servers have said is stored."""

    builds: set[str] = field(default_factory=set)
    names: dict[str, str] = field(default_factory=dict)
    # Session -> frames that were answered.
    sessions: dict[str, int] = field(default_factory=dict)
    # Anchor -> its heading, which each change makes larger.
    headings_deg: dict[str, float] = field(default_factory=dict)
    # Anchor -> when its newest frame was received.
    frames: dict[str, str] = field(default_factory=dict)


class Client(threading.Thread):
    """Edits, builds, pushes frames of anchors and walks sessions until the servers are gone."""

    def __init__(self, url: str, kept: Acknowledged, scan: bytes, picture: bytes, seed: int) -> None:
        super().__init__(daemon=True)
        self._url, self._kept, self._scan, self._picture, self._seed = url, kept, scan, picture, seed

    def run(self) -> None:
        """Call until a call fails for want of a server."""
        with suppress(httpx.TransportError), httpx.Client(base_url=self._url, timeout=WAIT_S) as client:
            server = Server(client, Path())
            answer = server.submit(self._scan, VENUE)
            if answer.status_code == 202:
                self._kept.builds.add(answer.json()["build"])
            for number in range(1000):
                self._edit(client, f"s{self._seed}-{number % 5}", f"name {number}")
                self._change_anchor(client, f"a{self._seed % 10}-{number % 2}")
                self._walk(client)

    def _edit(self, client: httpx.Client, venue: str, name: str) -> None:
        # A name that was sent and not acknowledged may be there or not.
        before = self._kept.names.pop(venue, None)
        if before is None:
            answer = client.post("/venues", json={"id": venue, "name": name})
        else:
            answer = client.patch(f"/venues/{venue}", json={"name": name})
        if answer.is_success:
            self._kept.names[venue] = name

    def _change_anchor(self, client: httpx.Client, anchor: str) -> None:
        heading_deg = self._kept.headings_deg.get(anchor, 0.0) + 0.25
        answer = client.put(f"/anchors/{anchor}", json={**ANCHOR, "venue": VENUE, "heading_deg": heading_deg})
        if answer.is_success:
            self._kept.headings_deg[anchor] = heading_deg
        answer = client.post(f"/anchors/{anchor}/frames", files={"image": self._picture})
        if answer.is_success:
            self._kept.frames[anchor] = answer.json()["received_at"]

    def _walk(self, client: httpx.Client) -> None:
        answer = client.post("/sessions", json={"venue": VENUE, "camera": CAMERA_TEXT})
        if not answer.is_success:
            return
        session = answer.json()["session"]
        self._kept.sessions[session] = 0
        for _ in range(2):
            answer = client.post(f"/sessions/{session}/frames", files={"image": self._picture})
            if answer.is_success:
                self._kept.sessions[session] = answer.json()["frame"]


@contextmanager
def serving(
    data_dir: Path, database_url: str | None, count: int
) -> Iterator[list[tuple[subprocess.Popen[bytes], str]]]:
    """Start servers, each with its worker, on the same data; give them with their addresses; kill them in the end."""
    environment = dict(os.environ)
    if database_url is not None:
        environment["ROOMFIX_DATABASE_URL"] = database_url
    script = str(Path(__file__).parents[1] / "jobs" / "live_server.py")
    started = []
    for _ in range(count):
        port = free_port()
        command = [sys.executable, script, str(data_dir), str(port)]
        started.append((subprocess.Popen(command, env=environment), f"http://127.0.0.1:{port}"))
    try:
        for process, url in started:
            with httpx.Client(base_url=url, timeout=WAIT_S) as client:
                wait_for(
                    lambda client=client, process=process: _is_ready(client) or process.poll() is not None
                )
            assert process.poll() is None
        yield started
    finally:
        for process, _ in started:
            process.kill()
            process.wait()


def kill_one(processes: Processes, rng: random.Random) -> None:
    """Kill a server, or its worker."""
    process, _ = rng.choice(processes)
    workers = [pid for pid in children(process.pid) if _is_worker(pid)]
    if workers and rng.random() < 0.5:
        with suppress(ProcessLookupError):
            os.kill(workers[0], signal.SIGKILL)
    else:
        process.kill()


def _is_worker(pid: int) -> bool:
    with suppress(OSError):
        return SLOW_WORKER[-1].encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def check(server: Server, kept: Acknowledged, database: Database, view: View) -> None:
    """Check that all that was acknowledged is there, each build done once, and that queries are answered right."""
    ended = {build: server.wait(build) for build in kept.builds}
    # What was queued without being acknowledged is built too.
    wait_for(
        lambda: all(each["state"] in ENDED for each in server.client.get("/database/builds").json()),
        pause_s=POLL_S,
    )
    done = [each for each in ended.values() if each["state"] == "succeeded"]
    # Three deaths end a build; otherwise every one is done.
    others = [each for each in ended.values() if each not in done and each["error_code"] != "worker_died"]
    assert others == []
    versions = [item["version"] for item in server.client.get(f"/venues/{VENUE}/maps").json()]
    assert versions == list(range(len(versions), 0, -1))
    assert len({each["map_version"] for each in done}) == len(done)
    names = {venue["id"]: venue["name"] for venue in server.client.get("/venues").json()}
    assert {venue: names.get(venue) for venue in kept.names} == kept.names
    for session, frames in kept.sessions.items():
        answer = server.client.get(f"/sessions/{session}")
        assert answer.status_code == 200
        assert answer.json()["frames"] >= frames
    anchors = {anchor["id"]: anchor for anchor in server.client.get("/anchors").json()}
    # A change that was sent and not acknowledged may be there or not.
    for anchor, heading_deg in kept.headings_deg.items():
        assert anchors[anchor]["heading_deg"] in (heading_deg, heading_deg + 0.25)
    for anchor, received_at in kept.frames.items():
        assert anchors[anchor]["frame"]["received_at"] >= received_at
    if versions:
        result = server.locate(view.jpeg(), venue=VENUE)
        assert result["map_version"] == versions[0]
        assert pose_errors(result, view.world_from_camera)[0] < 0.05
    blobs = BlobStore.open(None, server.data_dir, server.data_dir / "cache")
    assert check_store(database, blobs, lambda *_: None).findings == []


WITHOUT_POSTGRES = pytest.mark.skipif(not is_installed(), reason="no PostgreSQL here")


@pytest.mark.timeout(0)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
@pytest.mark.parametrize(
    "servers", [1, pytest.param(2, marks=WITHOUT_POSTGRES)], ids=["sqlite", "postgresql"]
)
def test_kills_at_random_lose_nothing(tmp_path: Path, views: list[View], servers: int) -> None:
    scan = zipped(scan_files(views[:4]))
    if servers == 1:
        run_kills(tmp_path, None, servers, scan, views[2])
    else:
        with postgres() as url:
            run_kills(tmp_path, url, servers, scan, views[2])


def run_kills(folder: Path, database_url: str | None, servers: int, scan: bytes, view: View) -> None:
    kept = Acknowledged()
    database = Database(database_url or f"sqlite:///{folder / 'roomfix.db'}")
    for kill in range(KILLS + 1):
        rng = random.Random(f"{servers} {kill}")
        with serving(folder, database_url, servers) as processes:
            with httpx.Client(base_url=processes[-1][1], timeout=WAIT_S) as client:
                server = Server(client, folder)
                if kill == 0:
                    server.add_venue(VENUE)
                    client.put(f"/venues/{VENUE}/floors/0", json=FLOOR)
                check(server, kept, database, view)
            if kill == KILLS:
                break
            clients = [
                Client(url, kept, scan, view.jpeg(), 10 * kill + i) for i, (_, url) in enumerate(processes)
            ]
            for each in clients:
                each.start()
            time.sleep(rng.uniform(0.0, MOST_S))
            kill_one(processes, rng)
            # The work goes on a moment: with one of two servers, or with a new worker.
            time.sleep(rng.uniform(0.0, 1.0))
        for each in clients:
            each.join()
    database.close()
