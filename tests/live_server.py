"""A server in a process of its own, as operators start it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.ports import free_port
from tests.server import WAIT_S, wait_for

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class LiveServer:
    """A running server: its address, its process, and the file of its log."""

    url: str
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def memory_bytes(self) -> int:
        """Memory that the process has resident now (Linux)."""
        pages = Path(f"/proc/{self.process.pid}/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


@contextmanager
def serving(folder: Path, *options: str, **environment: str) -> Iterator[LiveServer]:
    """Run `roomfix serve` on a free port of loopback, with its data and its log in a folder."""
    port = free_port()
    command = [
        sys.executable,
        "-m",
        "app.cli",
        "serve",
        "--port",
        str(port),
        "--data-dir",
        str(folder / "data"),
    ]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [*command, *options],
            env={**os.environ, "PYTHONPATH": str(ROOT), "ROOMFIX_RUN_WORKER": "false", **environment},
            cwd=folder,
            stdout=log,
            stderr=log,
        )
    server = LiveServer(f"http://127.0.0.1:{port}", process, folder / "log")
    try:
        _wait_until_ready(server)
        yield server
    finally:
        process.terminate()
        process.wait(WAIT_S)


def _wait_until_ready(server: LiveServer) -> None:
    with httpx.Client(base_url=server.url) as client:

        def is_ready() -> bool:
            assert server.process.poll() is None, server.log.read_text(encoding="utf-8")
            with suppress(httpx.TransportError):
                return client.get("/readyz").status_code == 200
            return False

        wait_for(is_ready, pause_s=0.05)
