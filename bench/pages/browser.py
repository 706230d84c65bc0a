"""A page in Chromium, for measurements."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")


@contextmanager
def browser_page(*flags: str, width: int = 1280, height: int = 900) -> Iterator[Page]:
    """Open a browser with a page of this size, in pixels."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        chromium = os.environ.get("CHROMIUM", "/usr/bin/chromium")
        browser = driver.chromium.launch(executable_path=chromium, args=[*FLAGS, *flags])
        yield browser.new_context(viewport={"width": width, "height": height}).new_page()
        browser.close()
