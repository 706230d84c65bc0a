"""Queries of clients that have gone are not computed, or not to their end."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest

from app.api.executor import BoundedExecutor
from app.engine.stage_timer import IS_WANTED, NotWantedError, StageTimer
from bench.overload.request import locate_request
from tests.scenes import encode
from tests.server import assert_problem, listening, wait_for


@pytest.fixture
def held() -> threading.Event:
    return threading.Event()


def test_a_query_whose_client_has_gone_gives_its_place_in_the_queue_to_another(
    tmp_path: Path, held: threading.Event
) -> None:
    with listening(tmp_path, workers=1, queue_size=2) as (url, app), httpx.Client(base_url=url) as client:
        client.post("/venues", json={"id": "v", "name": "V"})
        executor: BoundedExecutor = app.state.roomfix.executor
        wait_for(lambda: executor.pending == 0)
        # The only worker is busy, and two queries wait.
        busy = executor._pool.submit(held.wait)
        address = urlsplit(url)
        waiting = [socket.create_connection((address.hostname, address.port)) for _ in range(2)]
        try:
            for connection in waiting:
                connection.sendall(locate_request(url, b"a picture", "v", None))
            wait_for(lambda: executor.pending == 2)
            waiting[0].close()
            wait_for(lambda: executor.pending == 1)
        finally:
            held.set()
        busy.result()
        # The other one is answered.
        assert b" 415 " in waiting[1].recv(1000)
        waiting[1].close()
        assert_problem(client.post("/locate", files={"image": b"a picture"}), 415)


def test_a_query_whose_client_goes_while_it_runs_is_given_up(
    tmp_path: Path, held: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    laps: list[str] = []
    wanted: list[Callable[[], bool] | None] = []

    def lap(timer: StageTimer, stage: str) -> None:
        wanted.append(IS_WANTED.get())
        laps.append(stage)
        held.wait()
        try:
            plain_lap(timer, stage)
        except NotWantedError:
            laps.append("given up")
            raise

    plain_lap = StageTimer.lap
    monkeypatch.setattr(StageTimer, "lap", lap)
    with listening(tmp_path, workers=1) as (url, app), httpx.Client(base_url=url) as client:
        client.post("/venues", json={"id": "v", "name": "V"})
        executor: BoundedExecutor = app.state.roomfix.executor
        picture = encode(np.zeros((240, 320, 3), np.uint8), ".jpg")
        try:
            with socket.create_connection((urlsplit(url).hostname, urlsplit(url).port)) as connection:
                connection.sendall(locate_request(url, picture, "v", None))
                wait_for(lambda: laps)
            is_wanted = wanted[0]
            assert is_wanted is not None
            wait_for(lambda: not is_wanted())
        finally:
            held.set()
        wait_for(lambda: executor.pending == 0)
        assert laps == ["decode", "given up"]
        # One who waits is answered.
        answer = client.post("/locate", data={"venue": "v"}, files={"image": picture})
        assert answer.json()["reason"] == "no_map"
