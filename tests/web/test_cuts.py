"""The server goes away in the middle of an upload and of drawing: the person is told, and nothing is lost.

The stream's cut is in `test_go.py`, that of a recording in `test_record.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.plans import collection, landmark
from tests.server import wait_for
from tests.web.camera_file import CUT_ERRORS
from tests.web.live import KEY, Server, Tab, live_server, watched_tab
from tests.web.pictures import keep_picture
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
PADDING_BYTES = 24_000_000
UPLOAD_BYTES_S = 4_000_000


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue whose floor has a plan and a landmark."""
    with live_server(tmp_path_factory.mktemp("cuts")) as server:
        client = server.client
        client.post("/venues", json={"id": "house", "name": "House"}).raise_for_status()
        floor = {"name": "Ground floor", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
        client.put("/venues/house/floors/0", json=floor).raise_for_status()
        image = scenes.encode(np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8), ".png")
        fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"0,{SIZE_PX[1] - 1}"}
        client.put("/venues/house/floors/0/plan", data=fields, files={"image": image}).raise_for_status()
        drawn = collection(landmark("door", 1.5, 1.5))
        client.put("/venues/house/floors/0/features", json=drawn).raise_for_status()
        yield server


@pytest.fixture
def studio(browser: Any, server: Server) -> Iterator[Tab]:
    with watched_tab(browser, CUT_ERRORS, locale="en-US") as tab:
        tab.page.add_init_script(f"sessionStorage.setItem('roomfix.key', '{KEY}')")
        tab.open(f"{server.url}/studio")
        tab.page.wait_for_load_state("networkidle")
        yield tab


def test_an_upload_goes_on_where_it_was_when_the_server_is_back(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page = studio.page
    visit(page, "Scan")
    room = scenes.Room()
    files = scenes.scan_files([room.view(pose) for pose in scenes.walk()[:8]])
    files["notes/padding.bin"] = np.random.default_rng(0).bytes(PADDING_BYTES)
    archive = tmp_path / "scan.zip"
    archive.write_bytes(scenes.zipped(files))
    network = page.context.new_cdp_session(page)
    network.send("Network.enable")
    limits = {"offline": False, "latency": 0, "downloadThroughput": -1, "uploadThroughput": UPLOAD_BYTES_S}
    network.send("Network.emulateNetworkConditions", limits)
    asked: list[Any] = []

    def note(request: Any) -> None:
        asked.append(request)

    page.on("request", note)
    page.locator("#archive").set_input_files(archive)
    page.get_by_text("Options", exact=True).click()
    page.locator("#scan-options").fill(f'{{"camera": [{scenes.CAMERA_TEXT}], "gravity": [0, 0, -1]}}')
    page.get_by_role("button", name="Upload and build").click()
    # A first part has arrived, and the next one is on its way.
    wait_for(lambda: page.wait_for_timeout(50) or sum(request.method == "PATCH" for request in asked) >= 2)
    server.stop()
    playwright.expect(page.locator("#progress")).to_contain_text("The connection is lost")
    keep_picture(page, tmp_path, "upload-cut")
    server.start()
    playwright.expect(page.locator("#report")).to_contain_text("Report on version 1")
    begun = [request for request in asked if request.method == "POST" and request.url.endswith("/uploads")]
    offsets = [int(request.headers["upload-offset"]) for request in asked if request.method == "PATCH"]
    assert len(begun) == 1
    # No part was begun before what had arrived.
    assert offsets == sorted(offsets)
    assert offsets.count(0) == 1


def test_what_is_drawn_while_the_server_is_away_is_saved_when_it_is_back(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page = studio.page
    visit(page, "Draw")
    playwright.expect(page.locator("#feature-list li")).to_have_count(1)
    page.get_by_role("button", name="Landmark", exact=True).click()
    click(page, 3.0, 3.0)
    server.stop()
    page.get_by_role("button", name="Save", exact=True).click()
    playwright.expect(page.locator("#board-error")).to_contain_text("saved as soon as the server is back")
    # One goes on drawing meanwhile.
    click(page, 4.0, 2.0)
    keep_picture(page, tmp_path, "drawing-cut")
    server.start()
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    features = server.client.get("/venues/house/floors/0/features").json()["features"]
    assert len(features) == 3
    assert features[0]["geometry"]["coordinates"] == [1.5, 1.5]
