"""An S3 server for tests: moto's, as a process of its own, where it is installed."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.server import wait_for

BUCKET = "roomfix"
ABSENT = "moto[server] is not installed"


def is_installed() -> bool:
    """Whether a server can be started here."""
    return all(importlib.util.find_spec(name) is not None for name in ("moto", "flask"))


@contextmanager
def s3(folder: Path) -> Iterator[dict[str, str]]:
    """Start a server with an empty bucket; give the environment variables by which clients find it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    with (folder / "s3.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=log, stderr=log
        )
    try:
        wait_for(lambda: _answers(url))
        assert httpx.put(f"{url}/{BUCKET}").status_code == 200
        yield {
            "AWS_ENDPOINT_URL": url,
            "AWS_ALLOW_HTTP": "true",
            "AWS_ACCESS_KEY_ID": "an-id",
            "AWS_SECRET_ACCESS_KEY": "a-secret",
            "AWS_REGION": "us-east-1",
        }
    finally:
        process.terminate()
        process.wait(10)


def _answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/moto-api/").status_code < 500
    except httpx.TransportError:
        return False
