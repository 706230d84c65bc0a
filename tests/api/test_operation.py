"""Keys, limits, request ids, a full queue, failures nobody expected, health and metrics, the OpenAPI document."""

from __future__ import annotations

import asyncio
import threading
import typing
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from pydantic import BaseModel, SecretStr

from app.api import database, floors, health, locate, venues
from app.api.executor import BoundedExecutor
from app.api.maps import versions
from app.errors import BusyError
from app.services.locate import LocateService
from tests.scenes import View
from tests.server import Server, assert_problem, running, wait_for

KEY = "the-right-key"
# What may be asked without a key: orchestrators and browsers have none.
PUBLIC = {"/healthz", "/readyz"}
ROUTERS = (database.router, floors.router, health.router, locate.router, versions.router, venues.router)


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that asks for a key."""
    folder = tmp_path_factory.mktemp("locked")
    with running(folder, run_worker=False, admin_key=SecretStr(KEY), wrong_keys_per_minute=0) as server:
        yield server


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with low limits: one thread, one place in its queue, small uploads."""
    limits = {"workers": 1, "queue_size": 1, "max_image_bytes": 50_000, "max_archive_bytes": 60_000}
    with running(tmp_path_factory.mktemp("small"), run_worker=False, **limits) as server:
        server.add_venue("v")
        yield server


def operations(server: Server) -> list[tuple[str, str]]:
    """Return method and path of every call in the OpenAPI document."""
    paths = server.client.get("/openapi.json").json()["paths"]
    return [(method.upper(), path) for path, calls in paths.items() for method in calls]


def test_every_call_but_health_asks_for_the_key(locked: Server) -> None:
    wrong = [
        {},
        {"Authorization": "Bearer wrong"},
        {"Authorization": f"Basic {KEY}"},
        {"Authorization": "Bearer"},
    ]
    wrong.append({"Authorization": "Bearer " + KEY.upper()})
    wrong.append({"Authorization": b"Bearer \xff\xfe".decode("latin-1").encode("latin-1")})  # type: ignore[dict-item]
    calls = [call for call in operations(locked) if call[1] not in PUBLIC]
    assert len(calls) >= 20
    with locked.unchanged():
        for method, path in calls:
            for headers in wrong:
                answer = locked.client.request(
                    method,
                    path.replace("{", "").replace("}", ""),
                    headers=headers,
                    json={"id": "x", "name": "x"},
                )
                assert answer.status_code == 401
                assert answer.headers["www-authenticate"] == 'Bearer realm="roomfix"'
                if method != "HEAD":
                    assert_problem(answer, 401, "unauthenticated")


def test_the_right_key_opens(locked: Server) -> None:
    headers = {"Authorization": f"Bearer {KEY}"}
    assert locked.client.get("/venues", headers=headers).json() == []
    assert locked.client.get("/metrics", headers=headers).status_code == 200
    assert locked.client.get("/healthz").status_code == 200
    assert locked.client.get("/readyz").status_code == 200


def test_a_key_is_asked_for_before_anything_is_said_about_the_request(locked: Server) -> None:
    for data in ({}, {"camera": "nonsense"}):
        answer = locked.client.post("/locate", data=data, files={"image": b"x"})
        assert_problem(answer, 401, "unauthenticated")


def test_a_request_id_is_kept_or_made(museum: Server) -> None:
    kept = museum.client.get("/healthz", headers={"X-Request-ID": "trace-42.a_b"})
    assert kept.headers["x-request-id"] == "trace-42.a_b"
    for insane in ("a b", "x" * 65, "<script>", ""):
        made = museum.client.get("/venues/none", headers={"X-Request-ID": insane}).headers["x-request-id"]
        assert made != insane
        assert len(made) == 32
    ids = {museum.client.get("/healthz").headers["x-request-id"] for _ in range(5)}
    assert len(ids) == 5


def test_an_unexpected_failure_is_a_500_with_its_id_and_no_details(
    museum: Server, queries: list[View], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("secret detail")

    monkeypatch.setattr(LocateService, "locate", fail)
    answer = museum.client.post(
        "/locate", files={"image": queries[0].jpeg()}, headers={"X-Request-ID": "failing-1"}
    )
    assert "log" in assert_problem(answer, 500, "internal")
    assert "secret" not in answer.text
    assert answer.headers["x-request-id"] == "failing-1"
    assert "failing-1" in caplog.text
    assert "secret detail" in caplog.text


@pytest.mark.parametrize("declared", [True, False], ids=["declared", "streamed"])
@pytest.mark.parametrize(
    ("path", "megabytes"),
    [("/locate", 2), ("/database/build", 2), ("/venues", 2)],
    ids=["image", "scan", "json"],
)
def test_a_body_over_the_limit_is_refused(small: Server, path: str, megabytes: int, declared: bool) -> None:
    boundary = b"--b\r\nContent-Disposition: form-data; name=%s; filename=x\r\n\r\n"
    field = b"archive" if path == "/database/build" else b"image"
    chunks = [boundary % field, *(bytes(250_000) for _ in range(4 * megabytes)), b"\r\n--b--\r\n"]
    kind = "application/json" if path == "/venues" else "multipart/form-data; boundary=b"
    content: Any = b"".join(chunks) if declared else iter(chunks)
    with small.unchanged():
        answer = small.client.post(path, content=content, headers={"Content-Type": kind})
        assert "larger than" in assert_problem(answer, 413, "upload_too_large")


def test_a_full_queue_answers_503_with_retry_after(small: Server, queries: list[View]) -> None:
    client = typing.cast(TestClient, small.client)
    executor: BoundedExecutor = client.app.state.roomfix.executor  # type: ignore[attr-defined]
    free = threading.Event()
    blocked = [client.portal.start_task_soon(executor.run, free.wait) for _ in range(2)]  # type: ignore[union-attr]
    try:
        wait_for(lambda: executor.pending == 2)
        answer = small.post_image(queries[0].jpeg(), {"venue": "v"})
        assert_problem(answer, 503, "busy")
        assert int(answer.headers["retry-after"]) >= 1
        # Everything but queries still answers.
        assert small.client.get("/readyz").status_code == 200
    finally:
        free.set()
    for task in blocked:
        task.result()
    assert small.post_image(queries[0].jpeg(), {"venue": "v"}).json()["reason"] == "no_map"


def test_a_call_that_is_given_up_while_it_waits_frees_its_place() -> None:
    async def scenario() -> None:
        executor = BoundedExecutor(workers=1, queue_size=1)
        free = threading.Event()
        first = asyncio.ensure_future(executor.run(free.wait))
        second = asyncio.ensure_future(executor.run(free.wait))
        await asyncio.sleep(0)
        with pytest.raises(BusyError):
            await executor.run(free.wait)
        second.cancel()
        with pytest.raises(asyncio.CancelledError):
            await second
        assert executor.pending == 1
        free.set()
        await first
        assert await executor.run(lambda: "answered") == "answered"
        executor.close()
        assert executor.pending == 0

    asyncio.run(scenario())


def test_readiness_names_the_parts(museum: Server, small: Server) -> None:
    checks = museum.client.get("/readyz").json()["checks"]
    # The disk of the machine that tests may be nearly full.
    assert {name for name, check in checks.items() if check != "ok"} <= {"disk"}
    assert set(checks) == {"database", "blobs", "disk", "models", "build_worker", "maps"}
    blobs = small.data_dir / "blobs"
    blobs.rename(blobs.with_name("away"))
    try:
        answer = small.client.get("/readyz")
        assert_problem(answer, 503, "not_ready")
        assert answer.json()["checks"]["blobs"] != "ok"
        assert small.client.get("/healthz").status_code == 200
    finally:
        blobs.with_name("away").rename(blobs)


def test_metrics_count_requests_by_route_and_queries_by_outcome(museum: Server, queries: list[View]) -> None:
    museum.locate(queries[0].jpeg(), venue="museum")
    museum.client.get("/venues/none")
    text = museum.client.get("/metrics").text
    assert 'roomfix_locate_total{outcome="located",venue="museum"}' in text
    assert 'roomfix_requests_total{method="POST",route="/locate",status="200"}' in text
    assert 'route="/venues/{venue}",status="404"' in text
    assert "/venues/none" not in text
    assert 'roomfix_locate_stage_seconds_count{stage="match"}' in text
    assert 'roomfix_builds{stage="",state="succeeded"}' in text
    assert "roomfix_build_worker_alive 1.0" in text
    assert "roomfix_venues_with_map_problem 0.0" in text
    assert "process_resident_memory_bytes" in text


def test_the_openapi_document_describes_every_call(museum: Server) -> None:
    document = museum.client.get("/openapi.json").json()
    for path, calls in document["paths"].items():
        for method, call in calls.items():
            assert call["description"].endswith("."), (method, path)
            assert call["tags"], (method, path)
            answers = {status for status in call["responses"] if status.startswith("4")}
            assert answers or path in PUBLIC, (method, path)
            for status in answers:
                assert "application/problem+json" in call["responses"][status]["content"], (method, path)


def json_bodies() -> list[type[BaseModel]]:
    """Return the models of all JSON request bodies."""
    routes = [route for router in ROUTERS for route in router.routes if isinstance(route, APIRoute)]
    hints = (hint for route in routes for hint in typing.get_type_hints(route.endpoint).items())
    return [
        hint
        for name, hint in hints
        if name != "return" and isinstance(hint, type) and issubclass(hint, BaseModel)
    ]


@pytest.mark.parametrize("model", json_bodies(), ids=lambda model: model.__name__)
def test_every_json_body_has_an_example_that_is_valid(model: type[BaseModel]) -> None:
    extra = model.model_config.get("json_schema_extra")
    assert isinstance(extra, dict), "json_schema_extra is missing"
    example = extra["example"]
    assert isinstance(example, dict)
    assert set(model.model_validate(example).model_dump(exclude_unset=True)) == set(example)


def test_the_examples_work(empty: Server) -> None:
    schemas = empty.client.get("/openapi.json").json()["components"]["schemas"]
    venue = schemas["NewVenue"]["example"]
    assert empty.client.post("/venues", json=venue).status_code == 201
    floor = empty.client.put(f"/venues/{venue['id']}/floors/0", json=schemas["NewFloor"]["example"])
    assert floor.status_code == 200
    assert floor.json()["plan_residual_m"] == pytest.approx(0, abs=1e-9)
