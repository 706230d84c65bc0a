"""What is refused before it is read: queries without room, methods that no route takes."""

from __future__ import annotations

import threading
import typing
from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from app.api.executor import BoundedExecutor
from tests.server import Server, assert_problem, running, wait_for


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An open server with one thread and no queue to speak of."""
    folder = tmp_path_factory.mktemp("open")
    with running(folder, run_worker=False, workers=1, queue_size=1) as server:
        server.add_venue("v")
        yield server


@pytest.mark.parametrize("path", ["/locate", "/sessions/none/frames", "/anchors/none/frames"])
def test_without_room_an_image_is_refused_unread(server: Server, path: str) -> None:
    client = typing.cast(TestClient, server.client)
    executor: BoundedExecutor = client.app.state.roomfix.executor  # type: ignore[attr-defined]
    free = threading.Event()
    blocked = [client.portal.start_task_soon(executor.run, free.wait) for _ in range(2)]  # type: ignore[union-attr]
    try:
        wait_for(lambda: executor.pending == 2)
        # Not even a form: had it been read, it would be a 422.
        answer = server.client.post(path, content=b"\x00" * 1000)
        assert_problem(answer, 503, "busy")
        assert int(answer.headers["retry-after"]) >= 1
    finally:
        free.set()
    for task in blocked:
        task.result()
    assert server.client.post(path, content=b"\x00" * 1000).status_code in (404, 415)


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("DELETE", "/locate", {"POST"}),
        ("PUT", "/venues", {"GET", "POST"}),
        ("POST", "/venues/v", {"GET", "PATCH", "DELETE"}),
        ("POST", "/venues/v/floors/0/plan", {"GET", "PUT"}),
    ],
)
def test_a_method_that_no_route_takes_names_those_that_do(
    server: Server, method: str, path: str, allowed: set[str]
) -> None:
    answer = server.client.request(method, path)
    assert_problem(answer, 405, "method_not_allowed")
    assert {name.strip() for name in answer.headers["allow"].split(",")} >= allowed
