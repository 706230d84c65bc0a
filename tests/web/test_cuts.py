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
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, mark, visit

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


def held(page: Any, pattern: str) -> list[Any]:
    """Hold the next PUT to an address back: it is in the list once it is made. Those that follow go on."""
    routes: list[Any] = []

    def hold(route: Any) -> None:
        if route.request.method == "PUT" and not routes:
            routes.append(route)
        else:
            route.continue_()

    page.route(pattern, hold)
    return routes


def cut_while_it_saves(page: Any, pattern: str, button: str) -> None:
    """Press a button, and take the network away when what it sends is on its way."""
    routes = held(page, pattern)
    page.get_by_role("button", name=button, exact=True).click()
    wait_for(lambda: page.wait_for_timeout(20) or routes)
    page.context.set_offline(True)
    routes[0].continue_()
    page.unroute(pattern)
    playwright.expect(page.locator("#board-error")).to_contain_text("saved as soon as the server is back")


def picture(width: int, height: int) -> dict[str, Any]:
    image = scenes.encode(np.full((height, width, 3), 128, np.uint8), ".png")
    return {"name": f"{width}.png", "mimeType": "image/png", "buffer": image}


def test_a_camera_is_neither_lost_nor_exchanged_when_the_network_is_cut_while_it_is_saved(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page, client = studio.page, server.client
    seen = {
        "id": "sign",
        "region_px": [[4, 4], [40, 4], [40, 30]],
        "position": {"x": 3, "y": 2},
        "distance_m": 2,
    }
    hall = {"venue": "house", "floor": "0", "position": {"x": 1, "y": 2}, "height_m": 2.5, "pois": [seen]}
    hall |= {"camera": "90,90,60,40", "store_images": True}
    client.put("/anchors/hall", json=hall).raise_for_status()
    client.post("/anchors/hall/frames", content=picture(120, 80)["buffer"]).raise_for_status()
    before = client.get("/anchors/hall").json()
    visit(page, "Cameras")
    playwright.expect(page.locator("#cameras li")).to_contain_text("hall")
    said, shown, name = (page.locator(f"#{part}") for part in ("board-error", "picture", "camera-id"))
    click(page, 1.5, 4.5)
    name.fill("desk")
    page.locator("#camera-intrinsics").fill("200, 200, 160, 120")
    page.locator("#camera-picture").set_input_files(picture(320, 240))
    playwright.expect(shown).to_have_attribute("viewBox", "-0.5 -0.5 320 240")
    mark(shown, (0.25, 0.25), (0.5, 0.5))
    page.get_by_label("Id of the place").fill("print")
    page.get_by_role("button", name="The place", exact=True).click()
    click(page, 3.5, 2.0)

    # What was not stored is still there, its picture too.
    cut_while_it_saves(page, "**/anchors/desk", "Save camera")
    assert client.get("/anchors/desk").status_code == 404
    playwright.expect(name).to_have_value("desk")
    playwright.expect(shown).to_have_attribute("viewBox", "-0.5 -0.5 320 240")
    playwright.expect(page.locator("#pois li")).to_contain_text("print")
    keep_picture(page, tmp_path, "camera-cut")
    page.context.set_offline(False)
    playwright.expect(said).to_contain_text("The camera is stored.")
    stored = client.get("/anchors/desk").json()
    corners = np.array(stored["pois"][0]["region_px"])
    assert np.allclose(corners[[0, 2]], [[80, 60], [160, 120]], atol=2)
    playwright.expect(shown).to_have_attribute("viewBox", "-0.5 -0.5 320 240")

    # Another camera is opened meanwhile: each keeps what is its own.
    page.locator("#camera-height").fill("2.75")
    cut_while_it_saves(page, "**/anchors/desk", "Save camera")
    page.get_by_role("button", name="Edit: hall").click()
    playwright.expect(name).to_have_value("hall")
    page.context.set_offline(False)
    playwright.expect(said).to_contain_text("The camera desk is stored.")
    assert client.get("/anchors/desk").json() == stored | {"height_m": 2.75}
    changing = ("frame", "uses")
    after = client.get("/anchors/hall").json()
    assert {key: after[key] for key in after if key not in changing} == {
        key: before[key] for key in before if key not in changing
    }
    playwright.expect(name).to_have_value("hall")
    playwright.expect(shown).to_have_attribute("viewBox", "-0.5 -0.5 120 80")
    playwright.expect(page.locator("#picture .region-name")).to_have_text("sign")


def test_what_is_drawn_while_it_is_saved_and_on_another_floor_stays_where_it_belongs(
    server: Server, studio: Tab
) -> None:
    page, client = studio.page, server.client
    attic = {"name": "Attic", "level": 1, "z_min_m": 3, "z_max_m": 6}
    client.put("/venues/house/floors/1", json=attic).raise_for_status()
    page.reload()
    visit(page, "Draw")
    entries = page.locator("#feature-list li")
    playwright.expect(entries.first).to_be_attached()
    count = entries.count()
    page.get_by_role("button", name="Landmark", exact=True).click()
    click(page, 2.0, 4.0)
    # One more while the save is on its way.
    pattern = "**/floors/0/features"
    routes = held(page, pattern)
    page.get_by_role("button", name="Save", exact=True).click()
    wait_for(lambda: page.wait_for_timeout(20) or routes)
    click(page, 5.0, 4.0)
    routes[0].continue_()
    page.unroute(pattern)
    said = page.locator("#board-error")
    playwright.expect(said).to_contain_text("What you drew since you pressed Save is not saved yet.")
    playwright.expect(entries).to_have_count(count + 2)
    assert len(client.get("/venues/house/floors/0/features").json()["features"]) == count + 1

    # What could not be saved on one floor is not stored on another that is opened meanwhile.
    cut_while_it_saves(page, pattern, "Save")
    page.locator("#floor").select_option("1")
    playwright.expect(page.locator("#floor option:checked")).to_have_text("Attic")
    page.context.set_offline(False)
    # Later than what the page does within the second after which it tries again.
    page.evaluate("() => new Promise((done) => setTimeout(done, 1000))")
    playwright.expect(entries).to_have_count(0)
    assert client.get("/venues/house/floors/1/features").json()["features"] == []
    page.locator("#floor").select_option("0")
    playwright.expect(said).to_contain_text("What you drew and didn't save is back")
    playwright.expect(entries).to_have_count(count + 2)
