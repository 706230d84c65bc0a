"""A worker whose database another program holds waits and goes on; one that dies of an error says so and ends."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.jobs.embedded import EmbeddedRunner
from app.settings import Settings
from tests.jobs.live_server import SLOW_WORKER
from tests.jobs.test_kill import VENUE, WithRunner
from tests.locks import locked
from tests.scenes import View, scan_files, zipped
from tests.server import WAIT_S, running

# How long the worker waits for the lock each time, so that locks of several attempts are soon over.
LOCK_WAIT_S = 0.3
LONG_S = 3.5 * LOCK_WAIT_S


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, views: list[View]) -> Iterator[WithRunner]:
    """A server whose worker can be held at a stage."""
    folder = tmp_path_factory.mktemp("locked")
    runner = EmbeddedRunner(Settings(_env_file=None, data_dir=folder, open=True), SLOW_WORKER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LOCK_WAIT_S", str(LOCK_WAIT_S))
        with running(folder, runner) as server:
            site = WithRunner(server, zipped(scan_files(views[:4])), views[3])
            site.runner = runner
            site.prepare()
            yield site


@pytest.mark.parametrize("stage", ["describe", "publish"])
def test_a_build_waits_for_the_lock_and_goes_on(site: WithRunner, stage: str) -> None:
    build, pid = site.submit_and_hold(stage), site.runner.pid
    with locked(site.server.data_dir / "roomfix.db"):
        site.release()
        time.sleep(LONG_S)
        assert site.server.status(build)["state"] == "running"
    ended = site.server.wait(build)
    assert (ended["state"], ended["attempts"]) == ("succeeded", 1), ended["error"]
    assert site.runner.pid == pid


def test_an_idle_worker_lives_through_a_lock(site: WithRunner) -> None:
    pid = site.runner.pid
    with locked(site.server.data_dir / "roomfix.db"):
        site.runner.wake()
        time.sleep(LONG_S)
        assert site.runner.alive()
    build = site.submit_and_hold("unpack")
    site.release()
    assert site.server.wait(build)["state"] == "succeeded"
    assert (site.runner.pid, site.server.status(build)["venue"]) == (pid, VENUE)


def test_a_worker_that_can_not_open_its_database_ends_with_its_error(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "ROOMFIX_DATA_DIR": str(tmp_path),
        "ROOMFIX_DATABASE_URL": f"sqlite:///{tmp_path / 'nowhere' / 'x.db'}",
    }
    command = [sys.executable, "-m", "app.jobs.worker"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as worker:
        # The pipe stays open, as with a server: only the error ends the worker.
        assert worker.wait(WAIT_S) == 1
        assert worker.stderr is not None
        assert "unable to open database file" in worker.stderr.read().decode()
