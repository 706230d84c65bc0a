"""The balancer of `roomfix rolling-restart`: servers that are leaving or gone get nothing; gaps are between answers."""

from __future__ import annotations

import asyncio
from pathlib import Path

from bench.overload.request import NO_ANSWER, ask, get_request
from bench.rolling.balancer import Balancer
from bench.rolling.clients import Answers
from tests.ports import free_port
from tests.server import listening


def test_only_servers_that_are_ready_are_asked(tmp_path: Path) -> None:
    gone = f"http://127.0.0.1:{free_port()}"
    with listening(tmp_path / "a") as (first, leaving), listening(tmp_path / "b") as (second, _):

        async def statuses(balancer: Balancer) -> list[int]:
            listener = await asyncio.start_server(balancer.serve, "127.0.0.1", 0)
            url = f"http://127.0.0.1:{listener.sockets[0].getsockname()[1]}"
            found = [(await ask(url, get_request(url, "/readyz"))).status for _ in range(4)]
            listener.close()
            return found

        async def asked() -> None:
            balancer = Balancer()
            balancer.servers = [first, gone, second]
            assert await statuses(balancer) == [NO_ANSWER] * 4
            await balancer.check()
            assert balancer.ready == {first, second}
            # One that stops without a word is passed over.
            balancer.ready.add(gone)
            assert await statuses(balancer) == [200] * 4
            leaving.state.drain.is_leaving = True
            await balancer.check()
            assert balancer.ready == {second}
            assert await statuses(balancer) == [200] * 4

        asyncio.run(asked())


def test_a_gap_is_between_good_answers() -> None:
    answers = Answers([200, 0, 200, 200, 503], [1.0, 2.0, 4.0, 4.5, 9.0])
    assert answers.longest_gap_s() == 3.0
    assert answers.longest_gap_s(until_s=3.0) == 0.0
    assert Answers().longest_gap_s() == 0.0
