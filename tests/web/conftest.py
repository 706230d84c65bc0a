"""A live server and a browser for each module of tests, and a tab for each test."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.server import WAIT_S
from tests.web.live import Server, Tab, chromium, live_server, watched_tab


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that asks for a key."""
    with live_server(tmp_path_factory.mktemp("served")) as server:
        yield server


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    """Playwright, of which a process can run one at a time."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    playwright.expect.set_options(timeout=1000 * WAIT_S)
    with playwright.sync_playwright() as driver:
        yield driver


@pytest.fixture(scope="module")
def browser(driver: Any) -> Iterator[Any]:
    """A browser."""
    with chromium(driver) as browser:
        yield browser


@pytest.fixture
def tab(browser: Any) -> Iterator[Tab]:
    """A new page; after the test it must not have complained, nor asked any other host for anything."""
    with watched_tab(browser) as tab:
        yield tab
