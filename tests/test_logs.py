"""Lines of the log: JSON and for people, with level and request id in threads too, and without keys."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from app.api.executor import BoundedExecutor
from app.logs import LogFormat, configure_logs, line_formatter, log_context
from tests.live_server import serving
from tests.server import wait_for

KEY = "rfk_0123456789abcdef_secretsecretsecret"


@pytest.fixture
def root() -> Iterator[logging.Logger]:
    """The root logger, brought back afterwards."""
    logger = logging.getLogger()
    handlers, level = logger.handlers[:], logger.level
    yield logger
    logger.handlers[:], logger.level = handlers, level


def line(log_format: LogFormat, message: str, *arguments: object, error: Exception | None = None) -> str:
    details = None if error is None else (type(error), error, error.__traceback__)
    record = logging.LogRecord("roomfix.api", logging.WARNING, __file__, 1, message, arguments, details)
    return line_formatter(log_format).format(record)


def test_a_line_of_json_has_time_level_logger_and_context() -> None:
    with log_context(request_id="r-1"):
        values = json.loads(line("json", "map %s is damaged", "Müseum"))
    assert values.pop("timestamp").endswith("Z")
    assert values == {
        "event": "map Müseum is damaged", "level": "warning", "logger": "roomfix.api", "request_id": "r-1",
    }  # fmt: skip
    assert "request_id" not in json.loads(line("json", "later"))


def test_a_line_for_people_is_one_line() -> None:
    with log_context(request_id="r-2"):
        text = line("console", "ready")
    assert "\n" not in text
    for part in ("warning", "ready", "roomfix.api", "request_id=r-2"):
        assert part in text


@pytest.mark.parametrize("log_format", ["console", "json"])
def test_keys_are_hidden_in_messages_arguments_context_and_tracebacks(log_format: LogFormat) -> None:
    error = RuntimeError(f"called with Bearer {KEY}")
    with log_context(path=f"/locate?key={KEY}"):
        text = line(log_format, f"a {KEY} and %s", f"Bearer {KEY}", error=error)
    assert "RuntimeError" in text
    assert "secretsecret" not in text


def test_lines_of_a_worker_thread_have_the_id_of_their_request() -> None:
    executor = BoundedExecutor(1, 4)

    async def serve(request_id: str) -> str:
        with log_context(request_id=request_id):
            return await executor.run(lambda: str(json.loads(line("json", "work"))["request_id"]))

    async def serve_both() -> list[str]:
        return await asyncio.gather(serve("r-3"), serve("r-4"))

    assert asyncio.run(serve_both()) == ["r-3", "r-4"]
    executor.close()


def test_configuring_twice_writes_each_line_once(
    root: logging.Logger, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        configure_logs("info", "json")
    logging.getLogger("roomfix").info("once")
    logging.getLogger("roomfix").debug("never")
    assert [json.loads(each)["event"] for each in capsys.readouterr().err.splitlines()] == ["once"]


def test_a_server_writes_json_with_the_id_of_each_request(tmp_path: Path) -> None:
    with serving(tmp_path, "--open", ROOMFIX_LOG_FORMAT="json", ROOMFIX_LOG_LEVEL="debug") as server:
        answer = httpx.get(f"{server.url}/venues/none", headers={"X-Request-ID": "mine-1"})
        assert answer.headers["x-request-id"] == "mine-1"

        def lines() -> list[dict[str, str]]:
            texts = server.log.read_text(encoding="utf-8").splitlines()
            return [json.loads(text) for text in texts if text.startswith("{")]

        mine = wait_for(lambda: [each for each in lines() if each.get("request_id") == "mine-1"])
        assert mine[0]["event"].startswith("GET /venues/none: 404 in ")
        assert mine[0]["level"] == "debug"
        assert any("poses by" in each["event"] and "request_id" not in each for each in lines())
