"""The pages' own drawing of a plan is measured: bytes, time and work, without complaints of the browser."""

from __future__ import annotations

import pytest

from bench.pages.browser import browser_page
from bench.pages.plan_drawing import drawings_served, measure_load
from tests.web.live import CHROMIUM


def test_the_own_drawing_is_measured() -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    with drawings_served(None) as served, browser_page() as page:
        load = measure_load(page, f"{served.address}/own.html", slower=1, seconds=1)
        assert page.locator("#board-svg .landmark").count() > 10
        assert page.locator("#board-svg .area").count() > 10
        sizes = dict(served.sizes)
    assert load.complaints == []
    assert load.drawn_ms > 0
    assert 0 < load.move_script_ms < load.move_task_ms
    assert 0 < load.pan_script_ms < load.pan_task_ms
    assert load.pan_frames_s > 0
    # The modules are counted, and what is drawn is not.
    assert sizes["/assets/js/studio/board.js"] > 500
    assert not {"/plan.png", "/plan.json"} & set(sizes)
