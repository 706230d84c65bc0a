"""The studio by keyboard alone: the whole way of a newcomer, and what the cross on the plan can do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import scenes
from tests.web.keyboard import KeyboardHands
from tests.web.live import Server, watched_tab
from tests.web.newcomer import MONITOR, go_the_whole_way
from tests.web.studio_page import spot

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# What the whole way takes, as `KeyboardHands` counts, and where that is written down.
ACTIONS = 283
PRESSES = 1000
# A page that lays itself out a moment later takes a few presses of Tab or of an arrow more: a share.
SLOWER = 0.02
PAGES = Path(__file__).parents[2] / "docs" / "pages.md"
# Pixels of the screen that an arrow key moves the cross.
STEP_PX = 16


@pytest.fixture
def hands(browser: Any, server: Server) -> Iterator[KeyboardHands]:
    """The studio, opened with the key by somebody who has no mouse."""
    with watched_tab(browser, ("401", "422", "409"), locale="en-US") as tab:
        hands = KeyboardHands(tab.page)
        hands.open(server.url)
        yield hands


def test_the_way_of_a_newcomer_by_keyboard_alone(
    hands: KeyboardHands, server: Server, tmp_path: Path
) -> None:
    """No pointer is used, and no script moves the keyboard; what is stored is the same as by mouse."""
    go_the_whole_way(server, hands, tmp_path)
    assert (hands.actions, hands.presses) == pytest.approx((ACTIONS, PRESSES), rel=SLOWER)
    words = PAGES.read_text(encoding="utf-8")
    assert f"**{ACTIONS} actions** by keyboard alone" in words
    assert f"about {PRESSES:,} presses of keys" in words


def test_a_place_is_drawn_moved_and_left_by_keyboard(hands: KeyboardHands, server: Server) -> None:
    """The cross says where it is; Space takes hold and lets go; Escape puts back, drops, and goes back."""
    page = hands.page
    said, name = page.locator("#board-says"), page.locator("#feature-name")
    hands.visit("Draw")
    playwright.expect(page.locator("#board")).to_contain_text("Hall")
    hands.press("Landmark")
    playwright.expect(page.locator("#board")).to_be_focused()
    hands.spot(2.5, 2.0)
    playwright.expect(name).to_be_focused()
    hands.write("Bench")
    hands.key("Enter")
    hands.press("Select")
    hands.spot(2.5, 2.0)
    playwright.expect(said).to_contain_text("m, on landmark Bench")
    playwright.expect(name).to_have_value("Bench")
    hands.key("Space")
    playwright.expect(said).to_contain_text("Held")
    hands.key("Shift+ArrowRight")
    hands.key("Escape")
    playwright.expect(said).to_have_text("Put back.")
    hands.press("Save")
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    before = place_of(server, "Bench")
    assert before == pytest.approx([2.5, 2.0], abs=0.03)

    hands.spot(2.5, 2.0)
    hands.key("Space")
    for _ in range(3):
        hands.key("ArrowRight")
    hands.key("Control+ArrowUp")
    hands.key("Space")
    playwright.expect(said).to_contain_text("Let go.")
    pixels_a_metre = spot(page, 1, 0)[0] - spot(page, 0, 0)[0]
    hands.key("Escape")
    playwright.expect(page.locator("#feature-form")).to_be_hidden()
    hands.key("Escape")
    playwright.expect(page.get_by_role("button", name="Select", exact=True)).to_be_focused()
    hands.press("Save")
    # The button has nothing to do any more: the keyboard goes on.
    playwright.expect(page.locator("#next-of-board")).to_be_focused()
    after = place_of(server, "Bench")
    moved = [3 * STEP_PX / pixels_a_metre, 1 / pixels_a_metre]
    assert [after[0] - before[0], after[1] - before[1]] == pytest.approx(moved, abs=0.02)
    hands.press("Try a route")
    playwright.expect(page.locator("#board")).to_be_focused()
    hands.key("Space")
    playwright.expect(said).to_have_text("There is nothing to take hold of here.")


def place_of(server: Server, name: str) -> list[float]:
    """Return the stored x and y of a feature."""
    features = server.client.get("/venues/house/floors/0/features").json()["features"]
    (found,) = [each for each in features if each["properties"].get("name") == name]
    return list(found["geometry"]["coordinates"])


def test_the_cross_stays_on_a_camera_s_picture(hands: KeyboardHands) -> None:
    page = hands.page
    hands.visit("Cameras")
    playwright.expect(page.locator("#cameras li").first).to_be_visible()
    view = scenes.Room().view(MONITOR)
    hands.file(page.locator("#camera-picture"), "p.png", "image/png", view.png())
    picture = page.locator("#picture")
    playwright.expect(picture.locator("image")).to_have_count(1)
    hands.reach(picture)
    for _ in range(12):
        hands.key("Shift+ArrowLeft")
        hands.key("Shift+ArrowUp")
    playwright.expect(page.locator("#picture-says")).to_have_text("At 0, 0.")
    hands.key("Enter")
    playwright.expect(picture.locator(".pin")).to_have_count(1)
    hands.key("Escape")
    playwright.expect(picture.locator(".pin")).to_have_count(0)
    hands.key("Enter")
    hands.key("Shift+ArrowRight")
    hands.key("Shift+ArrowDown")
    hands.key("Enter")
    corners = [int(value) for value in page.locator("#region").input_value().split(",")]
    assert corners[:2] == [0, 0]
    assert min(corners[2:]) > 0


def test_the_way_past_the_navigation_keeps_the_view(hands: KeyboardHands) -> None:
    page = hands.page
    hands.visit("Draw")
    playwright.expect(page.locator("#title-board")).to_be_focused()
    hands.reload()
    playwright.expect(page.locator("#board")).to_contain_text("Hall")
    hands.key("Tab")
    playwright.expect(page.get_by_role("link", name="Skip to content")).to_be_focused()
    hands.key("Enter")
    playwright.expect(page.locator("#title-board")).to_be_focused()
    assert page.evaluate("() => location.hash") == "#draw"
    page.goto(page.url.replace("/studio#draw", "/#keys"))
    playwright.expect(page.locator("#keys-list .card").first).to_be_visible()
    hands.key("Tab")
    hands.key("Enter")
    playwright.expect(page.locator("#content")).to_be_focused()
    assert page.evaluate("() => location.hash") == "#keys"


def test_who_would_click_pairs_too_far_out_is_told_to_zoom_in(hands: KeyboardHands) -> None:
    page, words = hands.page, hands.page.locator("#pair-words")
    page.set_viewport_size({"width": 320, "height": 568})
    hands.visit("Align")
    playwright.expect(page.locator("#board-svg image.scan")).to_be_visible()
    hands.press("Add a pair")
    for _ in range(3):
        hands.key("-")
    playwright.expect(words).to_contain_text("Zoom in first: here a pixel of the screen is")
    for _ in range(12):
        hands.key("+")
    playwright.expect(words).not_to_contain_text("Zoom in first")
    playwright.expect(words).to_contain_text("Click a point of the scan")
