"""A worker on PostgreSQL hears of a build that another process has queued."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import pytest
from sqlalchemy import text

from app.jobs import news as news_module
from app.jobs.news import News, NewsOptions
from app.storage.builds import BUILD_QUEUED
from app.storage.db import Database, notify
from bench.postgres import postgres
from tests.jobs.test_leases import VENUE, WITHOUT_POSTGRES, site
from tests.scenes import View, scan_files, zipped
from tests.server import WAIT_S

NEVER_S = "86400"


@WITHOUT_POSTGRES
def test_a_worker_that_checks_nothing_is_woken(tmp_path: Path, views: list[View]) -> None:
    """Its own checks of the queue are a day apart."""
    with postgres() as url, site(tmp_path, zipped(scan_files(views[:4])), url) as workers:
        first = workers.start(POLL_S=NEVER_S)
        assert workers.server.wait(workers.submit())["state"] == "succeeded"
        # What is handed over reaches a worker that is idle.
        workers.hold("describe")
        build = workers.submit()
        workers.wait_until_held()
        workers.start(POLL_S=NEVER_S)
        first.send_signal(signal.SIGTERM)
        assert first.wait(WAIT_S) == 0
        workers.release()
        assert workers.server.wait(build)["state"] == "succeeded"
        assert workers.server.client.get(f"/venues/{VENUE}/maps").json()[0]["version"] == 2


@WITHOUT_POSTGRES
def test_a_listener_comes_back_after_its_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(news_module, "OPTIONS", NewsOptions(retry_s=0.01))
    with postgres() as url:
        database, wake = Database(url), threading.Event()
        news = News(database, wake)
        news.start()
        try:
            # Each time that it has begun to listen, for what came before.
            for _ in range(3):
                assert wake.wait(WAIT_S)
                wake.clear()
                with database.write() as connection:
                    notify(connection, BUILD_QUEUED)
                assert wake.wait(WAIT_S)
                wake.clear()
                with database.write() as connection:
                    ended = connection.execute(
                        text(
                            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE query LIKE 'LISTEN%'"
                        )
                    )
                    assert len(ended.all()) == 1
        finally:
            news.stop()
            database.close()


def test_sqlite_has_no_notices(tmp_path: Path) -> None:
    database, wake = Database(f"sqlite:///{tmp_path / 'test.db'}"), threading.Event()
    News(database, wake).start()
    with database.write() as connection:
        notify(connection, BUILD_QUEUED)
    assert not wake.is_set()
    database.close()
