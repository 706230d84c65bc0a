"""Answers that come after another venue, floor, camera or view was chosen are not taken for the present one's."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.plans import collection, landmark
from tests.web.held import held_back
from tests.web.live import KEY, Server, live_server, watched_tab
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# The upper floor's plan has pixels half as large.
UPPER_SIZE_PX = (2 * SIZE_PX[0], 2 * SIZE_PX[1])
VENUES = ("early", "late")


def plan_of(size: tuple[int, int]) -> bytes:
    return scenes.encode(np.full((size[1], size[0], 3), 250, np.uint8), ".png")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with two venues whose floors have the same ids, each with a plan and a landmark; without maps."""
    with live_server(tmp_path_factory.mktemp("late")) as server:
        client = server.client
        for venue in VENUES:
            client.post("/venues", json={"id": venue, "name": f"Venue {venue}"}).raise_for_status()
            for level, size in enumerate((SIZE_PX, UPPER_SIZE_PX)):
                where = f"/venues/{venue}/floors/{level}"
                floor = {"name": f"Floor {level} of {venue}", "level": level}
                floor |= {"z_min_m": 3.0 * level, "z_max_m": 3.0 * level + 3}
                client.put(where, json=floor).raise_for_status()
                scale = METERS_PER_PIXEL * SIZE_PX[0] / size[0]
                fields = {"meters_per_pixel": scale, "origin_px": f"0,{size[1] - 1}"}
                client.put(f"{where}/plan", data=fields, files={"image": plan_of(size)}).raise_for_status()
                drawn = collection(landmark("door", 1.5, 1.5, name=f"Door {level} of {venue}"))
                client.put(f"{where}/features", json=drawn).raise_for_status()
        yield server


@pytest.fixture
def page(browser: Any, server: Server) -> Iterator[Any]:
    """A tab that has the key, and the venue `early` chosen."""
    with watched_tab(browser, locale="en-US") as tab:
        tab.page.on("dialog", lambda dialog: dialog.accept())
        tab.page.add_init_script(
            f"sessionStorage.setItem('roomfix.key', '{KEY}');"
            "if (!localStorage['roomfix.venue']) localStorage['roomfix.venue'] = 'early';"
        )
        yield tab.page


def begin_drawing(page: Any, server: Server) -> Any:
    """Open the studio where features are drawn, and return the name of the first."""
    page.goto(f"{server.url}/studio#draw")
    drawn = page.locator("#board-svg text").first
    playwright.expect(drawn).to_have_text("Door 0 of early")
    return drawn


def features(server: Server, venue: str, floor: str) -> list[Any]:
    found: list[Any] = server.client.get(f"/venues/{venue}/floors/{floor}/features").json()["features"]
    return found


def test_the_plan_of_the_floor_before_is_not_shown_under_the_present_one(server: Server, page: Any) -> None:
    drawn = begin_drawing(page, server)
    with held_back(page, "**/venues/early/floors/1/plan") as upper:
        page.locator("#floor").select_option("1")
        upper.wait()
        # Until it is there, what is still drawn of the floor before can't be stored as this one's.
        playwright.expect(page.locator("#draw-panel")).to_have_js_property("inert", True)
        playwright.expect(drawn).to_have_count(0)
        page.locator("#floor").select_option("0")
        playwright.expect(drawn).to_have_text("Door 0 of early")
        upper.release()
    playwright.expect(drawn).to_have_text("Door 0 of early")
    playwright.expect(page.locator("#board-svg image")).to_have_attribute("width", str(SIZE_PX[0]))
    page.get_by_role("button", name="Landmark", exact=True).click()
    click(page, 3.0, 2.0)
    page.get_by_role("button", name="Save", exact=True).click()
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    stored = features(server, "early", "0")
    assert np.allclose(stored[-1]["geometry"]["coordinates"], [3.0, 2.0], atol=0.05)
    assert len(features(server, "early", "1")) == 1


def test_another_venue_does_not_wait_for_the_one_before(server: Server, page: Any) -> None:
    drawn = begin_drawing(page, server)
    with held_back(page, "**/venues/late/floors") as floors:
        page.locator("#venue").select_option("late")
        floors.wait()
        playwright.expect(drawn).to_have_count(0)
        playwright.expect(page.locator("#floor")).to_be_disabled()
        page.locator("#venue").select_option("early")
        playwright.expect(drawn).to_have_text(re.compile("of early"))
        floors.release()
    playwright.expect(page.locator("#floor option:checked")).to_have_text("Floor 0 of early")
    playwright.expect(page.locator("#draw-panel")).to_have_js_property("inert", False)


def test_what_a_view_reads_is_not_drawn_over_the_next_one(server: Server, page: Any) -> None:
    drawn = begin_drawing(page, server)
    with held_back(page, "**/venues/early/phones") as phones, held_back(page, "**/anchors?*") as anchors:
        visit(page, "Phones")
        phones.wait()
        visit(page, "Cameras")
        anchors.wait()
        visit(page, "Draw")
        playwright.expect(drawn).to_have_text("Door 0 of early")
        phones.release()
        anchors.release()
        playwright.expect(drawn).to_have_text("Door 0 of early")
        # Neither goes on being read every few seconds.
        page.wait_for_timeout(2200)
        assert not phones.routes


def test_features_are_stored_on_the_floor_that_they_were_drawn_on(server: Server, page: Any) -> None:
    drawn = begin_drawing(page, server)
    before = len(features(server, "early", "0"))
    page.get_by_role("button", name="Landmark", exact=True).click()
    click(page, 4.5, 4.0)
    with held_back(page, "**/venues/early/floors/0/features", "PUT") as saved:
        page.get_by_role("button", name="Save", exact=True).click()
        saved.wait()
        page.locator("#floor").select_option("1")
        playwright.expect(drawn).to_have_text("Door 1 of early")
        saved.release()
    playwright.expect(page.locator("#board-error")).to_have_text("Saved.")
    playwright.expect(drawn).to_have_text("Door 1 of early")
    assert len(features(server, "early", "0")) == before + 1
    assert len(features(server, "early", "1")) == 1
    # It is no draft any more.
    page.locator("#floor").select_option("0")
    playwright.expect(page.locator("#feature-list li")).to_have_count(before + 1)
    playwright.expect(page.locator("#board-error")).to_be_empty()


def test_a_plan_that_is_not_saved_is_not_drawn_on(server: Server, page: Any) -> None:
    drawn = begin_drawing(page, server)
    visit(page, "Plan")
    shown = page.locator("#board-svg image")
    file = {"name": "new.png", "mimeType": "image/png", "buffer": plan_of((300, 200))}
    page.locator("#plan-image").set_input_files(file)
    playwright.expect(shown).to_have_attribute("width", "300")
    visit(page, "Draw")
    playwright.expect(drawn).to_have_text("Door 0 of early")
    playwright.expect(shown).to_have_attribute("width", str(SIZE_PX[0]))
    # The choice is not lost.
    visit(page, "Plan")
    playwright.expect(shown).to_have_attribute("width", "300")


def test_the_buttons_of_a_venue_go_with_it(server: Server, page: Any) -> None:
    page.goto(f"{server.url}/#floors")
    cards = page.locator("#floors-list h2")
    playwright.expect(cards).to_have_text([f"Floor {level} of early" for level in range(2)])
    with held_back(page, "**/venues/late/floors") as floors:
        page.locator("#venue").select_option("late")
        floors.wait()
        # "Delete" would mean the floor of the same id here.
        playwright.expect(cards).to_have_count(0)
        playwright.expect(page.locator("#plan-floor option")).to_have_count(0)
    playwright.expect(cards).to_have_text([f"Floor {level} of late" for level in range(2)])


def test_the_plan_of_another_venues_floor_of_the_same_id_is_not_shown(server: Server, page: Any) -> None:
    page.goto(f"{server.url}/#locate")
    shown = page.locator("#plan-svg image")
    playwright.expect(shown).to_have_attribute("width", str(SIZE_PX[0]))
    smaller = {"image": plan_of((90, 60))}
    fields = {"meters_per_pixel": 0.1, "origin_px": "0,59"}
    server.client.put("/venues/late/floors/0/plan", data=fields, files=smaller).raise_for_status()
    with held_back(page, "**/venues/late/floors/0/plan") as plan:
        page.locator("#venue").select_option("late")
        plan.wait()
        page.locator("#venue").select_option("early")
        playwright.expect(page.locator("#floor-tabs")).to_contain_text("of early")
        plan.release()
    playwright.expect(shown).to_have_attribute("width", str(SIZE_PX[0]))


def test_an_answer_is_shown_with_the_photo_that_it_is_for(server: Server, page: Any) -> None:
    page.goto(f"{server.url}/#locate")
    playwright.expect(page.locator("#floor-tabs")).to_contain_text("of early")
    photos = [
        {"name": f"{name}.png", "mimeType": "image/png", "buffer": plan_of((80, 60))}
        for name in ("first", "second")
    ]
    page.locator("#photo").set_input_files(photos[0])
    with held_back(page, "**/locate", "POST") as asked:
        page.get_by_role("button", name="Locate", exact=True).click()
        asked.wait()
        page.locator("#photo").set_input_files(photos[1])
        asked.release()
    playwright.expect(page.locator("#trail-list button")).to_have_attribute("title", "first.png")


def test_a_code_is_of_the_venue_and_the_purpose_that_are_chosen(server: Server, page: Any) -> None:
    page.goto(f"{server.url}/studio#share")
    make = page.get_by_role("button", name="Make the code")
    playwright.expect(page.locator("#address")).not_to_have_value("")
    make.click()
    playwright.expect(page.locator("#qr")).to_have_attribute(
        "alt", "QR code of the phone page of Venue early"
    )
    with held_back(page, "**/tokens", "POST") as tokens:
        make.click()
        tokens.wait()
        page.locator("#venue").select_option("late")
        playwright.expect(page.locator("#qr")).to_be_hidden()
        tokens.release()
        playwright.expect(make).to_be_enabled()
        playwright.expect(page.locator("#qr")).to_be_hidden()
    make.click()
    playwright.expect(page.locator("#qr")).to_have_attribute("alt", "QR code of the phone page of Venue late")


def test_nothing_is_said_of_places_before_they_are_known(server: Server, browser: Any) -> None:
    with watched_tab(browser, locale="en-US") as tab:
        page = tab.page
        with held_back(page, "**/floors/*/features") as places:
            tab.open(f"{server.url}/go/early#token={KEY}")
            playwright.expect(page.get_by_role("heading")).to_have_text("Venue early")
            # The button is there once the camera is; the dialog is the same.
            page.evaluate("() => { document.getElementById('tools').hidden = false; }")
            page.locator("#search").click()
            places.wait()
            playwright.expect(page.locator("#found")).to_have_text("The places are being read …")
            page.locator("#query").fill("door 1")
        playwright.expect(page.locator("#places button")).to_have_text("Door 1 of early Floor 1 of early")


def test_of_two_languages_the_one_chosen_last_is_spoken(server: Server, browser: Any) -> None:
    with watched_tab(browser, locale="en-US") as tab:
        page = tab.page
        tab.open(f"{server.url}/go/early#token={KEY}")
        page.evaluate("() => { document.getElementById('tools').hidden = false; }")
        words, language = page.locator("#search"), page.locator("#language")
        playwright.expect(words).to_have_text("Where to?")
        with held_back(page, "**/languages/go/de.json") as german:
            language.select_option("de")
            german.wait()
            language.select_option("en")
            german.release()
        playwright.expect(words).to_have_text("Where to?")
        playwright.expect(language).to_have_value("en")
