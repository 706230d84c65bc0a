"""The phone page in a real browser, whose camera is a file: a walk through the synthetic room."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.built_maps import publish
from tests.plans import collection, landmark, link
from tests.server import wait_for
from tests.web.camera_file import CUT_ERRORS, flags_for, write_walk
from tests.web.go_page import Wire, begin, dot, go, pictures, truth_of, words
from tests.web.held import held_back
from tests.web.live import KEY, Server, Tab, chromium, live_server, watched_tab
from tests.web.pictures import keep_picture

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
FPS = 10
METERS_PER_PIXEL, ORIGIN_PX = 0.02, (20.0, 170.0)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with the room's map, its plan, and two landmarks joined by a link; a venue without anything."""
    with live_server(tmp_path_factory.mktemp("go")) as server:
        client = server.client
        for venue in ("room", "bare"):
            client.post("/venues", json={"id": venue, "name": f"The {venue}"}).raise_for_status()
        for k, (floor, z_min_m) in enumerate([("g", -0.5), ("u", 3.0)]):
            body = {"name": f"Floor {floor}", "level": k, "z_min_m": z_min_m, "z_max_m": z_min_m + 3.5}
            body["plan_from_world"] = np.eye(4).tolist()
            client.put(f"/venues/room/floors/{floor}", json=body).raise_for_status()
        plan = scenes.encode(np.full((190, 240, 3), 240, np.uint8), ".png")
        fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"{ORIGIN_PX[0]},{ORIGIN_PX[1]}"}
        client.put("/venues/room/floors/g/plan", data=fields, files={"image": plan}).raise_for_status()
        features = collection(
            landmark("door", 0.3, 4.5, name="Große Tür"),
            landmark("window", 2.2, 1.75, name="Window"),
            link((0.3, 4.5), (2.2, 1.75)),
        )
        client.put("/venues/room/floors/g/features", json=features).raise_for_status()
        room = scenes.Room()
        scan = scenes.zipped(scenes.scan_files([room.view(pose) for pose in scenes.walk()]))
        options = {"camera": scenes.CAMERA_TEXT, "gravity": [0, 0, -1]}
        publish(server.folder / "data", "room", [(scan, options)])
        yield server


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walk as a YUV4MPEG2 file."""
    path = tmp_path_factory.mktemp("camera") / "walk.y4m"
    there_and_back = (*pictures(), *pictures()[::-1])
    return write_walk(path, there_and_back, scenes.CAMERA.width, scenes.CAMERA.height, FPS)


@pytest.fixture(scope="module")
def camera_browser(driver: Any, walk: Path) -> Iterator[Any]:
    """A browser whose camera shows the walk."""
    with chromium(driver, *flags_for(walk)) as browser:
        yield browser


@pytest.fixture
def phone(camera_browser: Any) -> Iterator[Tab]:
    """A tab as wide as a phone."""
    with watched_tab(
        camera_browser, CUT_ERRORS, viewport={"width": 390, "height": 780}, locale="en-US"
    ) as tab:
        yield tab


def test_the_dot_follows_the_camera_and_the_words_lead(server: Server, phone: Tab, tmp_path: Path) -> None:
    page = phone.page
    wire = go(server, phone)
    playwright.expect(page.get_by_role("heading")).to_have_text("The room")
    assert KEY not in page.url
    page.get_by_label("Show my dot to the people who run this place").check()
    begin(page)
    playwright.expect(page.locator(".you")).to_be_visible()
    errors: list[float] = []

    def has_moved_often() -> bool:
        page.wait_for_timeout(100)
        shown = dot(page)
        if int(shown["frame"]) <= len(wire.frames):
            at = truth_of(wire.frames[int(shown["frame"]) - 1]).translation
            errors.append(np.hypot(float(shown["x"]) - at[0], float(shown["y"]) - at[1]))
        return len(errors) > 20

    wait_for(has_moved_often)
    assert max(errors) < 0.5
    assert np.median(errors) < 0.1
    # Drawn where it is said to be.
    shown = page.evaluate(
        "() => [document.querySelector('.you').dataset.x, document.querySelector('.you .halo').getAttribute('cx')]"
    )
    assert float(shown[1]) == pytest.approx(ORIGIN_PX[0] + float(shown[0]) / METERS_PER_PIXEL, abs=0.1)

    page.get_by_role("button", name="Where to?").click()
    dialog = page.get_by_role("dialog")
    playwright.expect(dialog).to_contain_text("2 places")
    dialog.get_by_label("Name of a place").fill("grosse tur")
    playwright.expect(dialog).to_contain_text("No place has this name.")
    dialog.get_by_label("Name of a place").fill("tur")
    dialog.get_by_role("button", name="Große Tür").click()
    playwright.expect(page.locator("#go")).to_have_attribute("data-state", re.compile("leading|off-route"))
    playwright.expect(page.locator("#say-more")).to_contain_text("m to Große Tür")
    playwright.expect(page.locator(".way")).to_have_attribute("points", re.compile(r"\d"))
    playwright.expect(page.locator(".goal")).to_have_attribute("visibility", "visible")
    keep_picture(page, tmp_path, "leading")

    # The other landmark is on the walk itself.
    page.get_by_role("button", name="Where to?").click()
    page.get_by_label("Name of a place").fill("win")
    page.keyboard.press("Enter")
    playwright.expect(page.locator("#go")).to_have_attribute("data-state", "arrived")
    playwright.expect(words(page)).to_have_text("You have arrived")
    page.get_by_role("button", name="Stop").click()
    playwright.expect(page.locator("#say-more")).to_contain_text("Accurate to")
    assert len({answer["session"] for answer in wire.answers}) == 1
    assert all("timestamp" in hint for hint in wire.hints)
    # Who runs the place sees the dot, since its owner ticked that.
    (shared,) = server.client.get("/venues/room/phones").json()
    at = dot(page)
    assert np.hypot(shared["place"]["x"] - float(at["x"]), shared["place"]["y"] - float(at["y"])) < 0.5


def test_gravity_comes_from_the_devices_attitude(server: Server, phone: Tab) -> None:
    page = phone.page
    wire = go(server, phone)
    begin(page)

    def turned() -> bool:
        page.evaluate(
            "() => dispatchEvent(new DeviceOrientationEvent('deviceorientation', { beta: 60, gamma: 0, alpha: 10 }))"
        )
        page.wait_for_timeout(100)
        return any("gravity" in hint for hint in wire.hints)

    wait_for(turned)
    down = next(hint["gravity"] for hint in wire.hints if "gravity" in hint)
    # The top of the phone leans back by 30 degrees: the rear camera looks down by that.
    assert np.allclose(down, [0, np.cos(np.radians(30)), np.sin(np.radians(30))], atol=1e-3)
    found = page.evaluate(
        """async () => {
            const { downInPicture } = await import("/assets/js/go/gravity.js");
            return [[90, 0, 0], [0, 0, 0], [0, -90, 90], [0, 90, 270], [-90, 0, 180]].map((v) => downInPicture(...v));
        }"""
    )
    upright = [0, 1, 0]
    assert np.allclose(found, [upright, [0, 0, 1], upright, upright, upright], atol=1e-9)


def test_it_goes_on_by_itself_after_the_server_was_away(server: Server, phone: Tab) -> None:
    page = phone.page
    wire = go(server, phone)
    begin(page)
    playwright.expect(page.locator(".you")).to_be_visible()
    session = wire.answers[-1]["session"]
    server.stop()
    try:
        playwright.expect(words(page)).to_have_text("The connection is lost")
        playwright.expect(page.locator(".you")).to_have_class(re.compile("stale"))
    finally:
        server.start()
    playwright.expect(page.locator("#go")).to_have_attribute("data-state", "located")
    assert wire.opened >= 2
    assert wire.answers[-1]["session"] == session
    # A session that is gone meanwhile is begun anew.
    server.client.delete(f"/sessions/{session}").raise_for_status()
    wait_for(lambda: page.wait_for_timeout(50) or wire.answers[-1].get("session") not in (None, session))


def test_the_focal_length_is_learned_and_stated_the_next_time(server: Server, phone: Tab) -> None:
    page = phone.page
    go(server, phone)
    begin(page)
    wait_for(lambda: page.wait_for_timeout(50) or page.evaluate("() => localStorage['roomfix.camera']"))
    page.reload()
    wire = Wire.of(page)
    begin(page)
    wait_for(lambda: page.wait_for_timeout(50) or wire.hints)
    assert wire.hints[0]["camera"]["params"][0] == pytest.approx(scenes.CAMERA.focal_px, rel=0.05)


def test_it_says_plainly_when_it_does_not_know(server: Server, phone: Tab) -> None:
    go(server, phone, "bare")
    begin(phone.page)
    playwright.expect(words(phone.page)).to_have_text("Looking for your place …")
    playwright.expect(phone.page.locator("#say-more")).to_contain_text("no map yet")


def test_a_second_window_takes_over_and_the_screen_stays_on_until_then(server: Server, phone: Tab) -> None:
    page = phone.page
    # Headless browsers have no screen to keep on.
    page.add_init_script(
        """globalThis.locks = [];
        Object.defineProperty(navigator, "wakeLock", { value: { request: async (kind) => {
            locks.push(kind);
            return { release: async () => locks.pop() };
        } } });"""
    )
    wire = go(server, phone)
    begin(page)
    wait_for(lambda: page.wait_for_timeout(50) or wire.answers)
    session = wire.answers[-1]["session"]
    assert page.evaluate("() => locks") == ["screen"]
    page.evaluate(
        """([session, key]) => {
            new WebSocket(`ws://${location.host}/sessions/${session}/stream`, ["roomfix", `roomfix.key.${key}`]);
        }""",
        [session, KEY],
    )
    playwright.expect(words(page)).to_have_text("This way goes on in another window")
    playwright.expect(page.get_by_role("button", name="Show me where I am")).to_be_visible()
    wait_for(lambda: page.wait_for_timeout(20) or page.evaluate("() => locks") == [])


def test_of_two_destinations_the_one_chosen_last_is_led_to(server: Server, phone: Tab) -> None:
    page = phone.page
    wire = go(server, phone)
    begin(page)
    playwright.expect(page.locator(".you")).to_be_visible()

    def lead_to(name: str) -> None:
        page.get_by_role("button", name="Where to?").click()
        page.get_by_role("dialog").get_by_role("button", name=name).click()

    with held_back(page, "**/sessions/*", "PATCH") as changes:
        lead_to("Window")
        changes.wait()
        lead_to("Große Tür")
        # The session leads nowhere yet, and answers of before are for no destination.
        playwright.expect(page.locator("#go")).to_have_attribute("data-state", "located")
        changes.release()
        changes.release()
    playwright.expect(page.locator("#say-more")).to_contain_text("m to Große Tür")
    session = wire.answers[-1]["session"]
    assert server.client.get(f"/sessions/{session}").json()["destination"] == "door"


def test_without_a_token_a_key_is_asked_for(server: Server, phone: Tab) -> None:
    page = phone.page
    go(server, phone, token=False)
    dialog = page.get_by_role("dialog")
    playwright.expect(dialog).to_contain_text("Scan the QR code again")
    dialog.get_by_label("Key").fill(KEY)
    dialog.get_by_role("button", name="Use this key").click()
    playwright.expect(page.get_by_role("heading")).to_have_text("The room")


def test_an_unknown_venue_is_said_to_be_one(server: Server, phone: Tab) -> None:
    go(server, phone, "nowhere")
    playwright.expect(phone.page.locator("#say-more")).to_have_text(
        "There is no venue of this name here. Scan the QR code again."
    )
    phone.complaints[:] = [each for each in phone.complaints if "404" not in each]


def test_it_speaks_german(server: Server, phone: Tab) -> None:
    page = phone.page
    wire = go(server, phone, query="?language=de")
    page.get_by_role("button", name="Zeig mir, wo ich bin").click()
    playwright.expect(page.locator(".you")).to_be_visible()
    page.get_by_role("button", name="Wohin?").click()
    page.get_by_role("button", name="Große Tür").click()
    playwright.expect(page.locator("#say-more")).to_contain_text("m bis Große Tür")
    german = r"Gehen|gehen|biegen|Drehen|Weg|Biegen|drehen"
    playwright.expect(words(page)).to_have_text(re.compile(german))
    page.get_by_label("Sprache").select_option("en")
    playwright.expect(page.get_by_role("button", name="Where to?")).to_be_visible()
    playwright.expect(page.locator("#say-more")).to_contain_text("m to Große Tür")
    assert len({answer["session"] for answer in wire.answers}) == 1


def test_instructions_are_spoken_once_each(server: Server, phone: Tab) -> None:
    page = phone.page
    page.add_init_script(
        """globalThis.said = [];
        Object.defineProperty(globalThis, "speechSynthesis", { value: {
            speak: (u) => said.push([u.text, u.lang]), cancel() {} } });"""
    )
    go(server, phone)
    begin(page)
    page.get_by_role("button", name="Speak the instructions").click()
    page.get_by_role("button", name="Where to?").click()
    page.get_by_role("button", name="Große Tür").click()
    playwright.expect(page.locator("#say-more")).to_contain_text("m to Große Tür")
    wait_for(lambda: page.wait_for_timeout(50) or page.evaluate("() => said.length"))
    page.wait_for_timeout(1500)
    said = page.evaluate("() => said")
    assert {lang for _, lang in said} == {"en"}
    assert all(one != other for one, other in pairwise(said))


def test_without_a_camera_a_simulated_phone_walks(server: Server, browser: Any) -> None:
    size = {"width": 320, "height": 568}
    with watched_tab(browser, viewport=size, locale="en-US") as tab:
        go(server, tab)
        playwright.expect(tab.page.get_by_role("heading")).to_have_text("The room")
        # It plays what the scan saw, which is not for visitors with a token.
        playwright.expect(tab.page.get_by_role("button", name="Try it without a camera")).to_be_hidden()
    with (
        live_server(server.folder, ROOMFIX_OPEN="true", ROOMFIX_RUN_WORKER="false") as opened,
        watched_tab(browser, viewport=size, locale="en-US") as tab,
    ):
        wire = go(opened, tab, token=False)
        tab.page.get_by_role("button", name="Try it without a camera").click()
        playwright.expect(tab.page.locator(".you")).to_be_visible()
        playwright.expect(tab.page.locator("#say-more")).to_contain_text("Simulated phone")
        wait_for(lambda: tab.page.wait_for_timeout(50) or sum(each["located"] for each in wire.answers) > 2)


def test_a_camera_that_is_not_there_or_not_allowed_is_said(server: Server, browser: Any) -> None:
    with watched_tab(browser, viewport={"width": 320, "height": 568}, locale="en-US") as tab:
        go(server, tab)
        begin(tab.page)
        playwright.expect(tab.page.locator("#start-error")).to_contain_text(re.compile("camera"))


@pytest.mark.parametrize("size", [(320, 568), (568, 320), (390, 780), (1280, 720)])
def test_nothing_is_cut_off_or_scrolls_sideways(
    server: Server, camera_browser: Any, size: tuple[int, int], tmp_path: Path
) -> None:
    width, height = size
    viewport = {"width": width, "height": height}
    with watched_tab(camera_browser, CUT_ERRORS, viewport=viewport, locale="de-DE") as tab:
        go(server, tab)
        page = tab.page
        button = page.get_by_role("button", name="Zeig mir, wo ich bin")
        assert_inside(page, button, size)
        button.click()
        playwright.expect(page.locator(".you")).to_be_visible()
        page.get_by_role("button", name="Wohin?").click()
        page.get_by_role("button", name="Große Tür").click()
        playwright.expect(page.locator("#say-more")).to_contain_text("Große Tür")
        for control in page.get_by_role("button").all():
            assert_inside(page, control, size)
        box = page.locator("#plan").bounding_box()
        assert box["width"] * box["height"] > 0.2 * width * height
        page.screenshot(path=tmp_path / f"go-{width}x{height}.png")


def assert_inside(page: Any, control: Any, size: tuple[int, int]) -> None:
    assert page.evaluate("() => document.documentElement.scrollWidth") <= size[0]
    box = control.bounding_box()
    assert min(box["x"], box["y"]) >= 0
    assert box["x"] + box["width"] <= size[0] + 0.5
    assert box["y"] + box["height"] <= size[1] + 0.5
