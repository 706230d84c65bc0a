"""A hand that errs lays a small room's scan over its plan in the studio; and how an alignment is judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.pages.alignment import AlignPage, Misalignment, Site, misalignment, worst
from bench.pages.browser import browser_page
from tests import scenes
from tests.built_maps import publish
from tests.web.live import CHROMIUM, KEY, Server, live_server
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX

# The room's corner is at (1, 0.5) m of the plan, turned by a quarter.
TRUTH = np.array([[0, -1, 4.0], [1, 0, 0.5]])
CORNERS = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
MARKS = np.array([[2.0, 1.5], [3.8, 2.8], [0.2, 0.2], [0.2, 2.8]])


def site_at(address: str) -> Site:
    return Site(
        address=address,
        venue="house",
        floor="0",
        version=1,
        truth=TRUTH,
        marks=MARKS,
        corners=CORNERS,
        z_max_m=2.0,
        start_shift_m=0.4,
    )


def set_up(server: Server) -> None:
    """Make a venue with a map and a plan."""
    client = server.client
    client.post("/venues", json={"id": "house", "name": "House"}).raise_for_status()
    floor = {"name": "Ground floor", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
    client.put("/venues/house/floors/0", json=floor).raise_for_status()
    image = scenes.encode(np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8), ".png")
    fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"0,{SIZE_PX[1] - 1}"}
    client.put("/venues/house/floors/0/plan", data=fields, files={"image": image}).raise_for_status()
    room = scenes.Room()
    scan = scenes.zipped(scenes.scan_files([room.view(pose) for pose in scenes.walk()]))
    publish(server.folder / "data", "house", [(scan, {"camera": scenes.CAMERA_TEXT, "gravity": [0, 0, -1]})])


def test_a_hand_that_errs_aligns_a_room(tmp_path: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    with live_server(tmp_path) as server, browser_page() as page:
        set_up(server)
        page.add_init_script(f"sessionStorage.setItem('roomfix.key', '{KEY}')")
        headers = {"Authorization": f"Bearer {KEY}"}
        for seed in range(2):
            hands = AlignPage(page, site_at(server.url), seed, headers).work()
            assert hands.dragged.largest_m < 0.15
            assert hands.dragged.turn_deg < 1
            assert max(each.largest_m for each in hands.paired.values()) < 0.03
            # The hand does err.
            assert hands.dragged.largest_m > 1e-4


def test_the_worst_corner_the_turn_and_the_size_are_told() -> None:
    site = site_at("http://127.0.0.1")
    assert misalignment(TRUTH, site) == Misalignment(0, 0, 0, 0)
    shifted = np.column_stack([TRUTH[:, :2], TRUTH[:, 2] + [0.3, 0.4]])
    off = misalignment(shifted, site)
    assert (off.largest_m, off.mean_m, off.turn_deg) == pytest.approx((0.5, 0.5, 0))
    grown = misalignment(TRUTH * [[1.02], [1.02]], site)
    assert grown.size_percent == pytest.approx(2)
    turned = misalignment(np.array([[-1.0, 0, 0], [0, -1, 0]]), site)
    assert turned.turn_deg == pytest.approx(90)
    assert worst([off, grown, turned]) == Misalignment(
        max(off.largest_m, grown.largest_m, turned.largest_m),
        max(off.mean_m, grown.mean_m, turned.mean_m),
        turned.turn_deg,
        grown.size_percent,
    )
