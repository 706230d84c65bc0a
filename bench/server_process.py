"""A server of our own in a process of its own, for measurements."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from app.errors import RoomfixError

START_S = 300.0
# Longer than a server that drains, with its worker, has to end.
STOP_S = 300
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class ServerProcess:
    """A running server: its address, its process and its data folder."""

    url: str
    pid: int
    data_dir: Path


@contextmanager
def server_process(data_dir: Path, log: Path, **settings: str) -> Iterator[ServerProcess]:
    """Run `roomfix serve`, open and without a build worker, on a free port of loopback; stop it in the end."""
    process, url = start_server(data_dir, log, **settings)
    try:
        wait_until_ready(url, process, log)
        yield ServerProcess(url, process.pid, data_dir)
    finally:
        process.terminate()
        process.wait(STOP_S)


def start_server(data_dir: Path, log: Path, **settings: str) -> tuple[subprocess.Popen[bytes], str]:
    """Start such a server; return its process, which may not answer yet, and its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "app.cli",
        "serve",
        "--open",
        "--port",
        str(port),
        "--data-dir",
        str(data_dir),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "ROOMFIX_RUN_WORKER": "false", **settings}
    with log.open("wb") as output:
        process = subprocess.Popen(command, env=environment, stdout=output, stderr=output)  # noqa: S603 - our own code
    return process, f"http://127.0.0.1:{port}"


def wait_until_ready(url: str, process: subprocess.Popen[bytes], log: Path) -> None:
    """Return when a server is ready; raises `RoomfixError` with the end of its log when it isn't."""
    end = time.monotonic() + START_S
    with httpx.Client(base_url=url) as client:
        while time.monotonic() < end and process.poll() is None:
            with suppress(httpx.TransportError):
                if client.get("/readyz").status_code == 200:
                    return
            time.sleep(0.1)
    raise RoomfixError(f"The server did not start:\n{log.read_text(encoding='utf-8')[-2000:]}")
