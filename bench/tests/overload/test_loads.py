"""The loads of `roomfix overload`: who waits is counted, who goes away or reads slowly is not."""

from __future__ import annotations

import asyncio
import itertools
import os
from pathlib import Path

from bench.overload.load import at_a_rate, clients_in_turn, go_away, observing, read_slowly
from bench.overload.request import NO_ANSWER, ask, get_request
from tests.ports import free_port
from tests.server import listening


def test_loads_are_counted_by_what_was_answered(tmp_path: Path) -> None:
    with listening(tmp_path) as (url, _):
        health, nothing = get_request(url, "/healthz"), get_request(url, "/nothing")

        async def loads() -> None:
            async with observing(url, os.getpid()) as seen:
                await clients_in_turn(seen, url, health, clients=2, seconds=0.3)
                answered = len(seen.answers)
                await at_a_rate(seen, url, nothing, per_second=40.0, seconds=0.25)
                await go_away(url, health, clients=5, seconds=0.1)
                turns = itertools.count()
                await read_slowly(url, health, clients=3, is_over=lambda: next(turns) > 4)
            assert answered == len(seen.of_status(200)) >= 2
            assert len(seen.of_status(404)) == 10
            assert seen.goodput == answered / seen.seconds
            assert {answer.status for answer in seen.health} == {200}
            assert min(seen.memory_bytes) > 1e6

        asyncio.run(loads())


def test_a_server_that_is_not_there_gives_no_answer() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    assert asyncio.run(ask(url, get_request(url, "/"))).status == NO_ANSWER
