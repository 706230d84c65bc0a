"""What is refused before it is read: pages of other sites, queries without room, methods that no route takes."""

from __future__ import annotations

import threading
import typing
from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient
from pydantic import SecretStr

from app.api.executor import BoundedExecutor
from app.api.guards import is_from_other_site
from tests.server import Server, assert_problem, running, wait_for

LOCAL = "http://127.0.0.1:8000"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An open server with one thread and no queue to speak of."""
    folder = tmp_path_factory.mktemp("open")
    with running(folder, run_worker=False, workers=1, queue_size=1) as server:
        server.add_venue("v")
        yield server


@pytest.mark.parametrize(
    ("headers", "is_refused"),
    [
        ({}, False),
        ({"Sec-Fetch-Site": "same-origin", "Origin": LOCAL, "Host": "127.0.0.1:8000"}, False),
        ({"Sec-Fetch-Site": "none"}, False),
        ({"Origin": "http://localhost:9000", "Host": "localhost:9000"}, False),
        ({"Sec-Fetch-Site": "cross-site"}, True),
        ({"Sec-Fetch-Site": "same-site"}, True),
        ({"Origin": "https://evil.example", "Host": "127.0.0.1:8000"}, True),
        ({"Origin": "http://evil.example:8000", "Host": "evil.example:8000"}, True),
        ({"Origin": "http://127.0.0.1:3000", "Host": "127.0.0.1:8000"}, True),
        ({"Origin": "null", "Host": "127.0.0.1:8000"}, True),
        ({"Origin": "http://[::1"}, True),
    ],
    ids=str,
)
def test_pages_of_other_sites_change_nothing(
    server: Server, headers: dict[str, str], is_refused: bool
) -> None:
    calls = [("POST", "/database/build"), ("POST", "/venues/v/maps/1/activate"), ("DELETE", "/venues/none")]
    with server.unchanged():
        for method, path in calls:
            answer = server.client.request(method, path, headers=headers)
            if is_refused:
                assert_problem(answer, 403, "cross_site")
            else:
                assert answer.status_code in (404, 422)
    # What only reads stays open: a browser doesn't show it to the other page.
    assert server.client.get("/venues", headers=headers).status_code == 200


def test_streams_of_other_sites_are_refused() -> None:
    def scope(origin: bytes) -> dict[str, object]:
        return {"type": "websocket", "headers": [(b"origin", origin), (b"host", b"127.0.0.1:8000")]}

    assert is_from_other_site(scope(b"https://evil.example"))
    assert not is_from_other_site(scope(LOCAL.encode()))


def test_a_server_with_keys_asks_for_the_key_only(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("keys")
    with running(folder, run_worker=False, admin_key=SecretStr("k" * 20)) as server:
        headers = {"Sec-Fetch-Site": "cross-site", "Authorization": "Bearer " + "k" * 20}
        answer = server.client.post("/venues", json={"id": "x", "name": "x"}, headers=headers)
        assert answer.status_code == 201


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
    assert server.client.post(path, content=b"\x00" * 1000).status_code in (404, 422)


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
