"""Monitoring cameras in the studio: placed by clicks, with a draft, a live picture and a lens that the map finds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.built_maps import publish
from tests.server import wait_for
from tests.web.live import Server, Tab, live_server
from tests.web.pictures import keep_picture
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, mark, open_studio, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# The plan shows the world's own frame.
MONITOR = scenes.pose_at(1.2, 1.4, 2.1, 5.0, -12.0)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue that has a map, and a floor with a plan."""
    with live_server(tmp_path_factory.mktemp("cameras")) as server:
        client = server.client
        client.post("/venues", json={"id": "house", "name": "House"}).raise_for_status()
        floor = {"name": "Ground floor", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
        floor["plan_from_world"] = np.eye(4).tolist()
        client.put("/venues/house/floors/0", json=floor).raise_for_status()
        image = scenes.encode(np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8), ".png")
        fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"0,{SIZE_PX[1] - 1}"}
        client.put("/venues/house/floors/0/plan", data=fields, files={"image": image}).raise_for_status()
        room = scenes.Room()
        scan = scenes.zipped(scenes.scan_files([room.view(pose) for pose in scenes.walk()]))
        publish(
            server.folder / "data", "house", [(scan, {"camera": scenes.CAMERA_TEXT, "gravity": [0, 0, -1]})]
        )
        yield server


@pytest.fixture
def studio(browser: Any, server: Server) -> Iterator[Tab]:
    """The studio, opened with the key."""
    with open_studio(browser, server) as tab:
        yield tab


@pytest.fixture(scope="module")
def view() -> scenes.View:
    """What the monitoring camera sees."""
    return scenes.Room().view(MONITOR)


def begin(page: Any) -> None:
    visit(page, "Cameras")
    playwright.expect(page.locator("#board-svg image")).to_have_count(1)
    playwright.expect(page.locator("#cameras li").first).to_be_visible()


def test_a_camera_is_placed_by_clicks_and_its_draft_survives(
    server: Server, studio: Tab, view: scenes.View, tmp_path: Path
) -> None:
    page = studio.page
    begin(page)
    click(page, 1.5, 4.5)
    page.locator("#camera-id").press_sequentially("corner")
    page.locator("#camera-intrinsics").fill(scenes.CAMERA_TEXT)
    picture = {"name": "p.png", "mimeType": "image/png", "buffer": view.png()}
    page.locator("#camera-picture").set_input_files(picture)
    playwright.expect(page.locator("#picture image")).to_have_count(1)
    mark(page.locator("#picture"), (0.3, 0.3), (0.5, 0.6))
    page.get_by_label("Id of the place").fill("print")
    page.get_by_role("button", name="The place", exact=True).click()
    click(page, 3.5, 2.0)
    page.get_by_role("button", name="Add the place").click()
    playwright.expect(page.locator("#pois")).to_contain_text("print")
    playwright.expect(page.locator("#picture .region.kept")).to_have_count(1)
    keep_picture(page, tmp_path, "camera")

    # A word that was typed is one step of undo, and so is a click on the plan.
    undo, redo = (page.locator(f"#camera-{name}") for name in ("undo", "redo"))
    for _ in range(5):
        undo.click()
    playwright.expect(page.locator("#pois li")).to_have_count(0)
    playwright.expect(page.locator("#camera-intrinsics")).to_have_value("")
    playwright.expect(page.locator("#camera-id")).to_have_value("corner")
    undo.click()
    playwright.expect(page.locator("#camera-id")).to_have_value("")
    for _ in range(6):
        redo.click()
    playwright.expect(redo).to_be_disabled()
    page.reload()
    playwright.expect(page.locator("#board-error")).to_contain_text("The camera that you didn't save is back")
    playwright.expect(page.locator("#camera-id")).to_have_value("corner")
    playwright.expect(page.locator("#pois li")).to_have_count(1)

    page.get_by_role("button", name="Save camera").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The camera is stored.")
    playwright.expect(page.locator("#cameras")).to_contain_text("No picture yet")
    anchor = server.client.get("/anchors/corner").json()
    assert np.allclose([anchor["position"]["x"], anchor["position"]["y"]], [1.5, 4.5], atol=0.05)
    (poi,) = anchor["pois"]
    assert poi["distance_m"] == pytest.approx(np.hypot(2, 2.5), abs=0.1)
    (u0, v0), _, (u1, v1), _ = poi["region_px"]
    height, width = view.rgb.shape[:2]
    assert np.allclose([u0, v0, u1, v1], [0.3 * width, 0.3 * height, 0.5 * width, 0.6 * height], atol=3)
    # Nothing is unsaved any more.
    page.reload()
    playwright.expect(page.locator("#cameras")).to_contain_text("corner")
    playwright.expect(page.locator("#camera-id")).to_have_value("")
    playwright.expect(page.locator("#board-error")).to_be_empty()


def test_where_the_map_locates_a_phone_is_drawn_on_the_plan(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page = studio.page
    visit(page, "Phones")
    drawn, words = page.locator("#board-svg path.coverage"), page.locator("#coverage-words")
    playwright.expect(page.locator("#phone-words")).to_contain_text("No phone")
    playwright.expect(drawn).to_have_count(0)
    page.get_by_label("Show where the map locates a phone").check()
    playwright.expect(drawn).to_have_count(1)
    cells = server.client.get("/venues/house/maps/1/coverage", params={"floor": "0"}).json()["cells"]
    some = sum(any(cell["covered"]) for cell in cells)
    assert some
    playwright.expect(words).to_contain_text(f"On {some} m²")
    sectors = (drawn.get_attribute("d") or "").count("Z")
    assert sectors == sum(sum(cell["covered"]) for cell in cells)
    keep_picture(page, tmp_path, "coverage")
    # It stays when another view was open.
    visit(page, "Draw")
    playwright.expect(drawn).to_have_count(0)
    visit(page, "Phones")
    playwright.expect(drawn).to_have_count(1)


def test_what_is_missing_is_said(studio: Tab) -> None:
    page = studio.page
    begin(page)
    save, said = page.get_by_role("button", name="Save camera"), page.locator("#board-error")
    save.click()
    playwright.expect(said).to_contain_text("needs an id")
    page.locator("#camera-id").fill("hall")
    save.click()
    playwright.expect(said).to_contain_text("Click where the camera hangs")
    page.locator("#camera-x").fill("2")
    page.locator("#camera-y").fill("2")
    save.click()
    playwright.expect(said).to_contain_text("The lens is missing")
    page.get_by_role("button", name="Find them by the map").click()
    playwright.expect(said).to_contain_text("Choose a picture")
    page.locator("#camera-intrinsics").fill("500, 500, 320, 240")
    save.click()
    playwright.expect(said).to_contain_text("at least one place")
    page.get_by_role("button", name="Add the place").click()
    playwright.expect(said).to_contain_text("The place needs an id")


def test_the_map_gives_lens_and_pose_and_the_picture_is_live(
    server: Server, studio: Tab, view: scenes.View, tmp_path: Path
) -> None:
    page = studio.page
    begin(page)
    picture = {"name": "p.png", "mimeType": "image/png", "buffer": view.png()}
    page.locator("#camera-picture").set_input_files(picture)
    playwright.expect(page.locator("#picture image")).to_have_count(1)
    page.get_by_role("button", name="Find them by the map").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("and where the camera hangs")
    found = json.loads(page.locator("#camera-intrinsics").input_value())["params"]
    assert found[0] == pytest.approx(scenes.CAMERA.params[0], rel=0.05)
    # The rendered lens bends nothing.
    assert abs(found[4]) < 0.01
    x, y, z = (float(page.locator(f"#camera-{axis}").input_value()) for axis in ("x", "y", "height"))
    assert np.linalg.norm([x, y, z] - MONITOR.translation) < 0.15

    u, v = 0.4, 0.45
    height, width = view.rgb.shape[:2]
    pixel = np.array([[u * width, v * height]])
    seen = scenes.CAMERA.unproject(pixel, np.array([view.depth_m[int(v * height), int(u * width)]]))
    target = MONITOR.apply(seen)[0]
    mark(page.locator("#picture"), (u - 0.08, v - 0.1), (u + 0.08, v + 0.1))
    page.locator("#poi-name").fill("print")
    page.locator("#camera-id").fill("hall")
    page.get_by_role("button", name="The place", exact=True).click()
    click(page, *target[:2])
    page.locator("#poi-distance").fill(f"{np.linalg.norm(target - MONITOR.translation):.2f}")
    page.locator("#camera-keep").check()
    # The place that was described need not be added first.
    page.get_by_role("button", name="Save camera").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The camera is stored.")
    page.get_by_role("button", name="Find it in the map: hall").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("hall is found in the map")
    playwright.expect(page.locator("#cameras")).to_contain_text("Found in the map within")
    calibration = server.client.get("/anchors/hall").json()["calibration"]["plan"]
    assert (
        np.hypot(calibration["x"] - MONITOR.translation[0], calibration["y"] - MONITOR.translation[1]) < 0.1
    )
    another_frame_comes(server, page, view)
    keep_picture(page, tmp_path, "camera-live")
    # What the form doesn't show stays.
    before = server.client.get("/anchors/hall").json()
    page.locator("#camera-height").fill("2.2")
    page.get_by_role("button", name="Save camera").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The camera is stored.")
    after = server.client.get("/anchors/hall").json()
    assert after["height_m"] == 2.2
    assert {name: after[name] for name in ("pois", "camera", "store_images")} == {
        name: before[name] for name in ("pois", "camera", "store_images")
    }


def another_frame_comes(server: Server, page: Any, view: scenes.View) -> None:
    """Send one: the page shows it by itself, with the place drawn in it."""
    page.reload()
    page.get_by_role("button", name="Edit: hall").click()
    playwright.expect(page.locator("#picture-words")).to_contain_text("Its newest picture")
    first = page.locator("#picture image").get_attribute("href")
    server.client.post("/anchors/hall/frames", content=view.jpeg()).raise_for_status()
    wait_for(
        lambda: page.wait_for_timeout(200) or page.locator("#picture image").get_attribute("href") != first,
        60,
    )
    playwright.expect(page.locator("#picture .region.kept")).to_have_count(1)
    playwright.expect(page.locator("#cameras li", has_text="hall")).to_contain_text("Last picture")
