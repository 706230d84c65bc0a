"""A live server and tabs of a real browser that watch for complaints, for tests of the pages."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.ports import free_port
from tests.server import WAIT_S, wait_for

CHROMIUM = Path(os.environ.get("CHROMIUM", "/usr/bin/chromium"))
KEY = "key-of-the-browser-test"
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


@dataclass(slots=True)
class Server:
    """A live server: its address, and a client that has the key. It can be stopped and started again."""

    url: str
    client: httpx.Client
    folder: Path
    options: dict[str, str]
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the server and wait until it is ready."""
        port = self.url.rpartition(":")[2]
        command = [sys.executable, "-m", "app.cli", "serve", "--host", "127.0.0.1", "--port", port]
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [*command, "--data-dir", str(self.folder / "data")],
                env={**os.environ, "ROOMFIX_ADMIN_KEY": KEY, "ROOMFIX_OPEN": "false", **self.options},
                cwd=Path(__file__).parents[2],
                stdout=log,
                stderr=log,
            )
        wait_for(self._is_ready, pause_s=0.05)

    def _is_ready(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, (self.folder / "log").read_text(encoding="utf-8")
        try:
            return self.client.get("/readyz").status_code == 200
        except httpx.TransportError:
            return False

    def stop(self) -> None:
        """Stop the server as an operator does."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(WAIT_S)


@dataclass
class Tab:
    """A page, and what went wrong or left the machine while it was open."""

    page: Any
    complaints: list[str] = field(default_factory=list)

    def open(self, url: str) -> None:
        """Go to an address."""
        self.page.goto(url)


@contextmanager
def live_server(folder: Path, **options: str) -> Iterator[Server]:
    """Serve a data folder in a process of its own; `options` are environment variables."""
    url = f"http://127.0.0.1:{free_port()}"
    with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {KEY}"}, timeout=WAIT_S) as client:
        server = Server(url, client, folder, options)
        server.start()
        try:
            yield server
        finally:
            server.stop()


@contextmanager
def chromium(driver: Any, *flags: str) -> Iterator[Any]:
    """Run a browser of a Playwright driver; skips the test where there is none."""
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}: apt-get install chromium")
    browser = driver.chromium.launch(executable_path=str(CHROMIUM), args=[*FLAGS, *flags])
    yield browser
    browser.close()


@contextmanager
def watched_tab(browser: Any, allowed: Sequence[str] = ("401",), **context_options: Any) -> Iterator[Tab]:
    """Open a page that in the end must not have complained, nor asked any other host for anything.

    `allowed` are parts of what the browser itself notes and may: the 401 that makes a page ask for the key.
    """
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **context_options})
    context.set_default_timeout(1000 * WAIT_S)
    tab = Tab(context.new_page())

    def console(message: Any) -> None:
        if message.type == "error" and not any(part in message.text for part in allowed):
            tab.complaints.append(message.text)

    def request(made: Any) -> None:
        if not made.url.startswith(("http://127.0.0.1:", "blob:", "data:")):
            tab.complaints.append(f"left the machine: {made.url}")

    tab.page.on("console", console)
    tab.page.on("pageerror", lambda error: tab.complaints.append(str(error)))
    tab.page.on("request", request)
    yield tab
    context.close()
    assert tab.complaints == [], tab.complaints
