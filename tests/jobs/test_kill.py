"""Whatever is killed, at whatever moment: the map before serves, nothing acknowledged is lost, nothing is left over."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest

from app.jobs import embedded
from app.jobs.embedded import EmbeddedRunner
from app.jobs.handlers import sweep
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import OPTIONS as QUEUE
from app.storage.sweep import referenced_blobs
from tests.jobs.live_server import SLOW_WORKER
from tests.ports import free_port
from tests.scenes import View, scan_files, zipped
from tests.server import ENDED, WAIT_S, Server, assert_sentence, running, wait_for

STAGES = ("unpack", "read", "register", "describe", "refine", "verify", "store", "publish")
VENUE = "v"


@pytest.fixture(scope="module")
def scan(views: list[View]) -> bytes:
    """A scan that is built in a moment."""
    return zipped(scan_files(views[:4]))


class Site:
    """A server whose worker can be held at a stage, with a venue that has a map."""

    def __init__(self, server: Server, scan: bytes, query: View) -> None:
        self.server, self._scan, self._query = server, scan, query

    def prepare(self) -> None:
        """Add the venue and its first map."""
        self.server.add_venue(VENUE)
        self.server.add_map(self._scan, VENUE)

    def submit_and_hold(self, stage: str) -> str:
        """Submit a build and return it when it waits at a stage."""
        self._hold.write_text(stage)
        answer = self.server.submit(self._scan, VENUE)
        assert answer.status_code == 202
        self.wait_until_held()
        assert self.server.status(answer.json()["build"])["stage"] == stage
        return str(answer.json()["build"])

    def wait_until_held(self) -> None:
        """Wait until the worker is at the stage where it is to be held."""
        wait_for(self._held.exists)

    def forget_held(self) -> None:
        """Forget that a worker, now dead, was held."""
        self._held.unlink()

    def release(self) -> None:
        """Let builds run on."""
        self._hold.unlink(missing_ok=True)
        self._held.unlink(missing_ok=True)

    def serves(self, version: int) -> None:
        """Check that queries are answered, and right, by this map version."""
        result = self.server.locate(self._query.jpeg(), venue=VENUE)
        assert result["map_version"] == version
        found = result["pose"]["position"]
        truth = self._query.world_from_camera.translation
        assert np.allclose([found["x"], found["y"], found["z"]], truth, atol=0.03)

    def leaves_nothing_behind(self, versions: int) -> None:
        """Check the rows, and after a sweep the files: all that is there belongs to a map version."""
        settings = Settings(_env_file=None, data_dir=self.server.data_dir, open=True)
        resources = Resources.open(settings)
        sweep(resources, timedelta(0))
        with resources.database.read() as connection:
            referenced = referenced_blobs(connection)
        assert resources.blobs.digests() == referenced
        resources.close()
        assert not list(settings.scratch_dir.iterdir())
        assert {Path(name).name for name in self.server.files()} == referenced
        rows = self.server.rows()
        assert len(rows["map_versions"]) == versions
        assert all(any(f"'{state}'" in row for state in ENDED) for row in rows["builds"])
        maps = self.server.client.get(f"/venues/{VENUE}/maps").json()
        assert [item["version"] for item in maps] == list(range(versions, 0, -1))
        keyframes = sum(item["statistics"]["map_keyframes"] for item in maps)
        assert len(rows["keyframe_images"]) == keyframes

    @property
    def _hold(self) -> Path:
        return self.server.data_dir / "hold"

    @property
    def _held(self) -> Path:
        return self.server.data_dir / "held"


class WithRunner(Site):
    """A site whose server runs in this process, its worker in another."""

    runner: EmbeddedRunner

    def kill_worker(self) -> int:
        """Kill the worker and return its process id."""
        pid = self.runner.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        wait_for(lambda: self.runner.pid != pid)
        return pid


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, scan: bytes, views: list[View]) -> Iterator[WithRunner]:
    """A site for all tests that kill the worker only."""
    folder = tmp_path_factory.mktemp("site")
    runner = EmbeddedRunner(Settings(_env_file=None, data_dir=folder, open=True), SLOW_WORKER)
    with pytest.MonkeyPatch.context() as patch:
        # Every other test waits for it.
        patch.setattr(embedded, "OPTIONS", embedded.SupervisionOptions(restart_delay_s=0.01))
        with running(folder, runner) as server:
            site = WithRunner(server, scan, views[3])
            site.runner = runner
            site.prepare()
            yield site


def present_version(site: Site) -> int:
    return int(site.server.client.get(f"/venues/{VENUE}").json()["map_version"])


@pytest.mark.parametrize("stage", STAGES)
def test_a_worker_killed_in_a_build_is_replaced_and_the_build_done(site: WithRunner, stage: str) -> None:
    before = present_version(site)
    build = site.submit_and_hold(stage)
    site.serves(before)
    dead = site.kill_worker()
    site.serves(before)
    site.release()
    ended = site.server.wait(build)
    assert (ended["state"], ended["map_version"]) == ("succeeded", before + 1), ended["error"]
    assert ended["attempts"] == 2
    assert site.runner.pid != dead
    assert site.runner.alive()
    site.serves(before + 1)
    site.leaves_nothing_behind(before + 1)


def test_a_build_that_kills_every_worker_fails_with_a_reason(site: WithRunner) -> None:
    before = present_version(site)
    build = site.submit_and_hold("describe")
    for _ in range(QUEUE.max_attempts):
        site.wait_until_held()
        # Whoever takes the build up next says so anew.
        site.forget_held()
        site.kill_worker()
    ended = site.server.wait(build)
    assert (ended["state"], ended["error_code"], ended["attempts"]) == (
        "failed",
        "worker_died",
        QUEUE.max_attempts,
    )
    assert "describe" in ended["error"]
    assert_sentence(ended["error"])
    site.release()
    site.serves(before)
    site.leaves_nothing_behind(before)


@pytest.mark.parametrize("stage", STAGES)
def test_a_build_is_cancelled_at_every_stage(site: WithRunner, stage: str) -> None:
    before, files = present_version(site), site.server.files()
    build = site.submit_and_hold(stage)
    answer = site.server.client.delete(f"/database/builds/{build}")
    assert (answer.status_code, answer.json()["state"]) == (202, "running")
    site.release()
    ended = site.server.wait(build)
    assert (ended["state"], ended["map_version"], ended["report"]) == ("cancelled", None, None)
    # Without any sweep: a cancelled build takes its archive and its pictures along.
    wait_for(lambda: site.server.files() == files)
    site.serves(before)
    site.leaves_nothing_behind(before)


def test_a_cancelled_build_stays_cancelled_when_its_worker_is_killed(site: WithRunner) -> None:
    before = present_version(site)
    build = site.submit_and_hold("refine")
    site.server.client.delete(f"/database/builds/{build}")
    site.kill_worker()
    site.release()
    assert site.server.wait(build)["state"] == "cancelled"
    site.leaves_nothing_behind(before)


def test_a_venue_deleted_under_its_build_takes_the_build_along(site: WithRunner, scan: bytes) -> None:
    before = present_version(site)
    site.server.add_venue("short-lived")
    (site.server.data_dir / "hold").write_text("store")
    build = site.server.submit(scan, "short-lived").json()["build"]
    site.wait_until_held()
    assert site.server.client.delete("/venues/short-lived").status_code == 204
    site.release()
    assert site.server.client.get(f"/database/builds/{build}").status_code == 404
    # The next build shows that the worker is still there, and has ended with the other one.
    assert site.server.build(scan, VENUE)["map_version"] == before + 1
    site.leaves_nothing_behind(before + 1)


# From here on the server is killed, too.


@contextmanager
def live(data_dir: Path) -> Iterator[tuple[subprocess.Popen[bytes], Server]]:
    """Start a server process on a data folder; give it when it is ready; kill it in the end."""
    port = free_port()
    script = str(Path(__file__).with_name("live_server.py"))
    process = subprocess.Popen([sys.executable, script, str(data_dir), str(port)])
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=WAIT_S) as client:
            server = Server(client, data_dir)
            wait_for(lambda: _is_ready(client) or process.poll() is not None)
            assert process.poll() is None
            yield process, server
    finally:
        process.kill()
        process.wait()


def _is_ready(client: httpx.Client) -> bool:
    with suppress(httpx.TransportError):
        return client.get("/readyz").status_code == 200
    return False


def children(pid: int) -> list[int]:
    """Return the process ids of a process's children."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(child) for child in text.split()]


def is_gone(pid: int) -> bool:
    """Return whether a process has ended, waited for or not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] in "ZX"
    except FileNotFoundError:
        return True


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_server_killed_again_and_again_loses_nothing(
    tmp_path: Path, scan: bytes, views: list[View]
) -> None:
    build = ""
    for round_, stage in enumerate(("", "unpack", "describe", "store", "publish")):
        with live(tmp_path) as (process, server):
            site = Site(server, scan, views[3])
            if not round_:
                site.prepare()
                continue
            if build:
                # What was acknowledged before the last kill is done now, by the new server's worker.
                site.release()
                assert server.wait(build)["map_version"] == round_, server.status(build)
            site.serves(round_)
            site.leaves_nothing_behind(round_)
            build = site.submit_and_hold(stage)
            (worker,) = wait_for(lambda process=process: workers_of(process.pid))
            process.send_signal(signal.SIGKILL)
            process.wait()
            wait_for(lambda worker=worker: is_gone(worker))
    with live(tmp_path) as (_, server):
        site = Site(server, scan, views[3])
        site.release()
        assert server.wait(build)["map_version"] == 5
        site.serves(5)
        site.leaves_nothing_behind(5)


def workers_of(pid: int) -> list[int]:
    """Return the slow workers among a process's children."""
    command = SLOW_WORKER[-1].encode()
    return [child for child in children(pid) if command in Path(f"/proc/{child}/cmdline").read_bytes()]


def test_what_was_acknowledged_survives_a_kill_right_after(
    tmp_path: Path, scan: bytes, views: list[View]
) -> None:
    with live(tmp_path) as (process, server):
        server.add_venue(VENUE)
        answer = server.submit(scan, VENUE)
        process.kill()
        assert answer.status_code == 202
    with live(tmp_path) as (_, server):
        assert server.wait(answer.json()["build"])["state"] == "succeeded"
        site = Site(server, scan, views[3])
        site.serves(1)
        site.leaves_nothing_behind(1)


def test_a_server_killed_in_an_upload_leaves_nothing(tmp_path: Path, scan: bytes, views: list[View]) -> None:
    with live(tmp_path) as (process, server):
        Site(server, scan, views[3]).prepare()

        def half_an_upload() -> Iterator[bytes]:
            yield (
                b"--b\r\nContent-Disposition: form-data; name=archive; filename=x\r\n\r\n"
                + scan[: len(scan) // 2]
            )
            process.kill()
            process.wait()
            yield scan[len(scan) // 2 :]

        kind = {"Content-Type": "multipart/form-data; boundary=b"}
        with pytest.raises(httpx.TransportError):
            server.client.post("/database/build", content=half_an_upload(), headers=kind)
    with live(tmp_path) as (_, server):
        site = Site(server, scan, views[3])
        site.serves(1)
        site.leaves_nothing_behind(1)
