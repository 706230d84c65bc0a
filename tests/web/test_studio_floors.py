"""The studio in a real browser: ways between floors, and phones that agreed to be shown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.storage.db import Database
from tests import scenes
from tests.plans import collection, landmark, link
from tests.services.plans.plan_files import picture
from tests.web.live import Server, Tab, live_server
from tests.web.pictures import keep_picture
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, open_studio, store_walk, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue whose ground floor has a plan, two landmarks and a link."""
    with live_server(tmp_path_factory.mktemp("floors")) as server:
        client = server.client
        client.post("/venues", json={"id": "house", "name": "House"}).raise_for_status()
        floor = {"name": "Ground floor", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
        floor["plan_from_world"] = np.eye(4).tolist()
        client.put("/venues/house/floors/0", json=floor).raise_for_status()
        image = scenes.encode(np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8), ".png")
        fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"0,{SIZE_PX[1] - 1}"}
        client.put("/venues/house/floors/0/plan", data=fields, files={"image": image}).raise_for_status()
        drawn = collection(
            landmark("door", 1.5, 1.5), landmark("window", 3.5, 4.0), link((1.5, 1.5), (3.5, 4.0))
        )
        client.put("/venues/house/floors/0/features", json=drawn).raise_for_status()
        yield server


@pytest.fixture
def studio(browser: Any, server: Server) -> Iterator[Tab]:
    """The studio, opened with the key."""
    with open_studio(browser, server) as tab:
        yield tab


def test_a_way_between_floors_is_drawn_changed_and_leads(server: Server, studio: Tab, tmp_path: Path) -> None:
    page, client = studio.page, server.client
    floor = {"name": "Upper floor", "level": 1, "z_min_m": 3.5, "z_max_m": 6.5}
    client.put("/venues/house/floors/1", json=floor).raise_for_status()
    visit(page, "Draw")
    page.reload()
    playwright.expect(page.locator("#board-svg image")).to_have_count(1)
    page.get_by_role("button", name="Stairs or lift").click()
    playwright.expect(page.locator("#draw-words")).to_contain_text("Draw a landmark on another floor first")
    above = collection(
        landmark("gallery", 3.0, 3.0, name="Gallery"), landmark("hatch", 1.0, 1.0, name="Hatch")
    )
    client.put("/venues/house/floors/1/features", json=above).raise_for_status()
    page.reload()
    playwright.expect(page.locator("#feature-list li")).to_have_count(3)
    page.get_by_role("button", name="Stairs or lift").click()
    # Snaps to the landmark that is drawn there.
    click(page, 3.52, 3.98)
    playwright.expect(page.get_by_label("The way is")).to_be_focused()
    page.get_by_label("The way is").select_option("lift")
    playwright.expect(page.get_by_label("and arrives there at")).to_have_value("gallery")
    page.get_by_label("and arrives there at").select_option("Hatch")
    page.get_by_role("button", name="Undo").click()
    playwright.expect(page.get_by_label("and arrives there at")).to_have_value("gallery")
    playwright.expect(page.locator("#board")).to_contain_text("lift to Upper floor")
    keep_picture(page, tmp_path, "floors")
    page.get_by_role("button", name="Save", exact=True).click()
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    features = client.get("/venues/house/floors/0/features").json()["features"]
    (way,) = [each for each in features if each["properties"].get("to_floor") == "1"]
    assert (way["properties"]["mode"], way["properties"]["to"]) == ("lift", "gallery")
    route = client.get("/venues/house/route", params={"from": "0:1.5,1.5", "to": "gallery"}).json()
    assert [step["mode"] for step in route["steps"] if step["to_floor"] == "1"] == ["lift"]


# Pairs of names on the board that can be seen and lie over each other.
OVERLAPPING = """() => {
    const texts = [...document.querySelectorAll("#board-svg text:not([visibility])")];
    const places = texts.map((text) => text.getBoundingClientRect());
    const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top;
    return texts.flatMap((text, i) => texts.slice(i + 1).flatMap((other, j) =>
        apart(places[i], places[i + 1 + j]) ? [] : [`${text.textContent}, ${other.textContent}`]));
}"""


def test_names_that_lie_close_together_can_be_read(server: Server, studio: Tab, tmp_path: Path) -> None:
    page, client = studio.page, server.client
    crowd = [landmark(f"bay{i}", 2.0 + 0.12 * i, 1.5 + 0.03 * i, name=f"Loading bay {i}") for i in range(12)]
    floor = {"name": "Cellar", "level": -1, "z_min_m": -4.0, "z_max_m": -0.5}
    client.put("/venues/house/floors/b1", json=floor).raise_for_status()
    client.put("/venues/house/floors/b1/features", json=collection(*crowd)).raise_for_status()
    visit(page, "Draw")
    page.reload()
    page.locator("#floor").select_option("b1")
    names, hidden = page.locator("#board-svg text"), page.locator("#board-svg text[visibility=hidden]")
    playwright.expect(names).to_have_count(12)
    playwright.expect(hidden).not_to_have_count(0)
    playwright.expect(hidden).not_to_have_count(12)
    assert page.evaluate(OVERLAPPING) == []
    # What is chosen is named, whatever is around it.
    page.get_by_text("All features", exact=True).click()
    page.get_by_role("button", name="landmark: Loading bay 7").click()
    chosen = page.locator("#board-svg g:has(> .chosen) > text")
    playwright.expect(chosen).to_have_text("Loading bay 7")
    # The names are new, and none of them is left out until they are placed.
    playwright.expect(hidden).not_to_have_count(0)
    playwright.expect(chosen).not_to_have_attribute("visibility", "hidden")
    assert page.evaluate(OVERLAPPING) == []
    keep_picture(page, tmp_path, "names")


def test_phones_that_agreed_are_shown_and_where_they_were_lost(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page, client = studio.page, server.client
    visit(page, "Phones")
    playwright.expect(page.locator("#phone-words")).to_have_text(
        "No phone has agreed to be shown in the last hour."
    )
    database = Database(f"sqlite:///{server.folder}/data/roomfix.db")
    shown, hidden = store_walk(database, share=True), store_walk(database, share=False)
    database.close()
    playwright.expect(page.locator("#phone-list li")).to_have_count(1)
    playwright.expect(page.locator("#phone-list")).to_contain_text(
        f"{shown[:8]}: tracking, on Ground floor at 3.0, 2.5 m"
    )
    playwright.expect(page.locator(".live-phone")).to_have_count(1)
    playwright.expect(page.locator(".lost-place")).to_have_count(1)
    keep_picture(page, tmp_path, "phones")
    (phone,) = client.get("/venues/house/phones").json()
    assert phone["lost"] == [{"floor": "0", "x": 2.0, "y": 2.5, "frames": 3}]
    assert hidden[:8] not in page.content()
    # Consent that is taken back holds at once.
    client.patch(f"/sessions/{shown}", json={"share": False}).raise_for_status()
    assert client.get("/venues/house/phones").json() == []
    playwright.expect(page.locator(".live-phone")).to_have_count(0)


def test_a_plan_of_many_pixels_is_fetched_as_far_as_it_is_in_view(server: Server, studio: Tab) -> None:
    page, client = studio.page, server.client
    floor = {"name": "Site", "level": 2, "z_min_m": 7.0, "z_max_m": 10.0}
    client.put("/venues/house/floors/2", json=floor).raise_for_status()
    image = picture("PNG", size=(9_000, 6_000))
    fields = {"meters_per_pixel": 0.01, "origin_px": "0,5999"}
    client.put("/venues/house/floors/2/plan", data=fields, files={"image": image}).raise_for_status()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url.split("/floors/2/")[-1]))
    visit(page, "Draw")
    page.reload()
    page.locator("#floor").select_option("Site")
    tiles = page.locator("#board-svg .plan-tiles image")
    playwright.expect(tiles.first).to_be_attached()
    playwright.expect(page.locator('#board-svg image[data-zoom="5"]')).to_have_count(0)
    page.locator("#board").focus()
    for _ in range(8):
        page.keyboard.press("+")
    finest = page.locator('#board-svg image[data-zoom="5"]')
    playwright.expect(finest.first).to_be_attached()
    assert "plan" not in asked
    assert 0 < sum(name.startswith("plan/tiles/5/") for name in asked) < 60
    # The whole plan is reduced by 2 to be shown: the tiles cover just that, whatever their zoom.
    box = page.evaluate("""() => { const b = document.querySelector('#board-svg image[data-zoom="0"]').getBBox();
        return [b.x, b.y, b.width, b.height]; }""")
    assert box == pytest.approx([-0.5, -0.5, 4500, 3000], abs=16)
    side = page.evaluate("() => document.querySelector('#board-svg image[data-zoom=\"5\"]').getBBox().width")
    assert side in (256, 148)
    # Tiles that are still asked for would be missing.
    page.goto("about:blank")
    client.delete("/venues/house/floors/2").raise_for_status()
