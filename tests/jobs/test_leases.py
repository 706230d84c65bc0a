"""Several workers on one database: each build is one worker's while it lives, and another's when it doesn't."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from app.jobs import lease as lease_module
from app.jobs.lease import LeaseOptions, LeaseWatch
from app.jobs.worker_name import is_surely_dead, worker_name
from app.storage.leases import Lease
from bench.postgres import is_installed
from tests.jobs.live_server import SLOW_WORKER
from tests.jobs.test_kill import is_gone
from tests.server import WAIT_S, Server, running, wait_for

VENUE = "v"
WITHOUT_POSTGRES = pytest.mark.skipif(not is_installed(), reason="no PostgreSQL here")


class Workers:
    """A server without a worker, and worker processes that a test starts and kills."""

    def __init__(self, server: Server, environment: dict[str, str], scan: bytes) -> None:
        self.server, self._environment, self.scan = server, environment, scan
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, **environment: str) -> subprocess.Popen[bytes]:
        """Start a worker process."""
        process = subprocess.Popen(
            SLOW_WORKER, stdin=subprocess.PIPE, env={**os.environ, **self._environment, **environment}
        )
        self.processes.append(process)
        return process

    def submit(self) -> str:
        """Queue a build."""
        return str(self.server.submit(self.scan, VENUE).json()["build"])

    def hold(self, stage: str) -> None:
        """Hold every worker that comes to a stage."""
        (self.server.data_dir / "hold").write_text(stage)

    def wait_until_held(self) -> None:
        """Wait until a worker is held."""
        wait_for((self.server.data_dir / "held").exists)

    def release(self) -> None:
        """Let them go on."""
        for name in ("hold", "held"):
            (self.server.data_dir / name).unlink(missing_ok=True)

    def versions(self) -> list[int]:
        """Return the map versions, newest first."""
        return [item["version"] for item in self.server.client.get(f"/venues/{VENUE}/maps").json()]

    def end(self) -> None:
        """Kill all workers."""
        self.release()
        for process in self.processes:
            process.kill()
            process.communicate()


@contextmanager
def site(folder: Path, scan: bytes, database_url: str | None) -> Iterator[Workers]:
    environment = {"ROOMFIX_DATA_DIR": str(folder), "ROOMFIX_OPEN": "true"}
    values = {}
    if database_url is not None:
        environment["ROOMFIX_DATABASE_URL"] = values["database_url"] = database_url
    with running(folder, run_worker=False, **values) as server:
        server.add_venue(VENUE)
        workers = Workers(server, environment, scan)
        try:
            yield workers
        finally:
            workers.end()


def test_two_workers_share_the_queue_and_take_over_from_the_dead(workers: Workers) -> None:
    workers.hold("describe")
    first = workers.start()
    held = workers.submit()
    workers.wait_until_held()
    # The second worker neither takes nor disturbs what the first one builds.
    second = workers.start()
    (workers.server.data_dir / "held").unlink()
    other = workers.submit()
    workers.wait_until_held()
    states = [workers.server.status(build) for build in (held, other)]
    assert [(each["state"], each["attempts"]) for each in states] == [("running", 1), ("running", 1)]
    # Killed, it loses its build to the one that lives; stopped in order, it counts no attempt.
    first.send_signal(signal.SIGKILL)
    first.wait()
    workers.release()
    ended = [workers.server.wait(build) for build in (held, other)]
    assert [(each["state"], each["attempts"]) for each in ended] == [("succeeded", 2), ("succeeded", 1)]
    assert workers.versions() == [2, 1]
    workers.hold("refine")
    handed = workers.submit()
    workers.wait_until_held()
    second.send_signal(signal.SIGTERM)
    assert second.wait(WAIT_S) == 0
    queued = workers.server.status(handed)
    assert (queued["state"], queued["attempts"]) == ("queued", 0)
    workers.release()
    third = workers.start(ROOMFIX_FINISH_BUILD_S="600")
    ended_too = workers.server.wait(handed)
    assert (ended_too["state"], ended_too["attempts"]) == ("succeeded", 1)
    assert workers.versions() == [3, 2, 1]
    # With time to finish, it ends its build and takes no other one.
    workers.hold("refine")
    finished, left = workers.submit(), workers.submit()
    workers.wait_until_held()
    third.send_signal(signal.SIGTERM)
    workers.release()
    assert third.wait(WAIT_S) == 0
    assert [workers.server.status(build)["state"] for build in (finished, left)] == ["succeeded", "queued"]
    assert workers.server.status(finished)["attempts"] == 1


def test_a_worker_that_was_given_up_publishes_nothing(tmp_path: Path, scan: bytes) -> None:
    """A process that is stopped, as a machine that sleeps, and goes on after another one has taken its build over."""
    with site(tmp_path, scan, None) as workers:
        workers.hold("store")
        first = workers.start()
        build = workers.submit()
        workers.wait_until_held()
        first.send_signal(signal.SIGSTOP)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("LEASE_S", "1.0")
            patch.setitem(workers._environment, "LEASE_S", "1.0")
            second = workers.start()
        (tmp_path / "held").unlink()
        # Its heart has stopped, although the process is there.
        workers.wait_until_held()
        assert workers.server.status(build)["attempts"] == 2
        workers.release()
        ended = workers.server.wait(build)
        assert (ended["state"], ended["map_version"]) == ("succeeded", 1)
        first.send_signal(signal.SIGCONT)
        # It finds that the build isn't its own any more, and takes the next one from the queue.
        second.kill()
        second.wait()
        again = workers.server.wait(workers.submit())
        assert (again["state"], again["map_version"]) == ("succeeded", 2)
        assert workers.versions() == [2, 1]
        assert workers.server.status(build)["attempts"] == 2


def test_a_lease_runs_out_by_silence_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(lease_module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(lease_module, "OPTIONS", LeaseOptions(lease_s=10.0, max_step_s=4.0))
    watch = LeaseWatch()

    def after(seconds: float, *leases: Lease) -> list[Lease]:
        now[0] += seconds
        return watch.run_out(list(leases))

    alive, silent = Lease("a", "elsewhere/1/2/3", 1), Lease("b", "elsewhere/4/5/6", 7)
    assert after(0, alive, silent) == []
    # The machine slept, or the database was locked: no heart could beat.
    assert after(1000, alive, silent) == []
    for beat in range(2, 6):
        found = after(3, Lease("a", "elsewhere/1/2/3", beat), silent)
    assert found == [silent]
    # A build of a release without leases has no worker.
    assert after(0, Lease("c", None, 0)) == [Lease("c", None, 0)]


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")
def test_a_process_of_this_machine_that_has_ended_is_surely_dead() -> None:
    assert not is_surely_dead(worker_name())
    code = "from app.jobs.worker_name import worker_name; print(worker_name(), flush=True); input()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdout is not None
    name = child.stdout.readline().decode().strip()
    assert not is_surely_dead(name)
    child.kill()
    # Even before its parent has asked how it ended.
    wait_for(lambda: is_gone(child.pid))
    assert is_surely_dead(name)
    child.communicate()
    assert is_surely_dead(name)
    for other in ("", "elsewhere/1/2/3", "/".join(["x", *name.split("/")[1:]])):
        assert not is_surely_dead(other)
    # The same process id, taken by another process.
    parts = worker_name().split("/")
    with suppress(IndexError):
        parts[2] = "1"
    assert is_surely_dead("/".join(parts))
