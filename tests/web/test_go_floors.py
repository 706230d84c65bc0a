"""The phone page in a house of two floors: its plan follows the walker, who may look at the other floor meanwhile."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.geometry.se3 import Pose
from tests import scenes
from tests.built_maps import publish
from tests.server import wait_for
from tests.web.camera_file import CUT_ERRORS, flags_for, write_walk
from tests.web.go_page import WALK, Wire, begin, go, pictures
from tests.web.live import Server, Tab, chromium, live_server, watched_tab
from tests.web.pictures import keep_picture

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
FPS = 10
RISE_M = 3.5
# Each floor's plan: its name, size in pixels, metres per pixel, and origin.
PLANS = {
    "g": ("Ground floor", (240, 190), 0.02, (20.0, 170.0)),
    "u": ("Upper floor", (480, 380), 0.01, (44.0, 350.0)),
}
UPSTAIRS = scenes.Room(seed=2)
# All that is shown, read in one go.
SHOWN = """() => {
    const at = (name) => document.querySelector(`#floors [${name}]`)?.dataset.floor ?? null;
    const you = document.querySelector(".you");
    return {
        shown: at("aria-pressed='true'"),
        walker: at("aria-current='location'"),
        follows: document.getElementById("follow").getAttribute("aria-pressed") === "true",
        width: Number(document.querySelector("#plan-svg image")?.getAttribute("width")),
        dot: you.getAttribute("visibility") === "visible"
            ? [Number(you.dataset.x), Number(you.querySelector(".halo").getAttribute("cx"))] : null,
        words: document.getElementById("say-words").textContent,
    };
}"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a house whose two floors are one room each, in one map."""
    with live_server(tmp_path_factory.mktemp("floors")) as server:
        client = server.client
        client.post("/venues", json={"id": "house", "name": "The house"}).raise_for_status()
        for level, (floor, (name, size, scale, origin)) in enumerate(PLANS.items()):
            body = {"name": name, "level": level, "z_min_m": RISE_M * level - 0.5}
            body |= {"z_max_m": RISE_M * level + 2.9, "plan_from_world": np.eye(4).tolist()}
            client.put(f"/venues/house/floors/{floor}", json=body).raise_for_status()
            plan = scenes.encode(np.full((size[1], size[0], 3), 240, np.uint8), ".png")
            fields = {"meters_per_pixel": scale, "origin_px": f"{origin[0]},{origin[1]}"}
            answer = client.put(f"/venues/house/floors/{floor}/plan", data=fields, files={"image": plan})
            answer.raise_for_status()
        ground = [scenes.Room().view(pose) for pose in scenes.walk()]
        upper = [raised(UPSTAIRS.view(pose)) for pose in scenes.walk()]
        scan = scenes.zipped(scenes.scan_files([*ground, *upper]))
        options = {"camera": scenes.CAMERA_TEXT, "world_from_scan": np.eye(4).tolist()}
        publish(server.folder / "data", "house", [(scan, options)])
        yield server


def raised(view: scenes.View) -> scenes.View:
    """Return a view as from a floor higher."""
    pose = view.world_from_camera
    return scenes.View(
        Pose(pose.rotation, pose.translation + np.array([0, 0, RISE_M])), view.rgb, view.depth_m
    )


@pytest.fixture(scope="module")
def camera_browser(driver: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser whose camera walks about on the ground floor, then on the upper one, and again."""
    upstairs = [UPSTAIRS.view(pose).rgb for pose in WALK]
    film = (*pictures(), *pictures()[::-1], *upstairs, *upstairs[::-1])
    path = tmp_path_factory.mktemp("camera") / "house.y4m"
    write_walk(path, film, scenes.CAMERA.width, scenes.CAMERA.height, FPS)
    with chromium(driver, *flags_for(path)) as browser:
        yield browser


@pytest.fixture
def phone(camera_browser: Any) -> Iterator[Tab]:
    """A tab as wide as a phone."""
    size = {"width": 390, "height": 780}
    with watched_tab(camera_browser, CUT_ERRORS, viewport=size, locale="en-US") as tab:
        yield tab


def walk_about(server: Server, phone: Tab) -> Wire:
    """Open the page, begin, and wait until the walker is shown."""
    wire = go(server, phone, "house")
    begin(phone.page)
    playwright.expect(phone.page.locator(".you")).to_be_visible()
    return wire


def until(page: Any, **wanted: Any) -> dict[str, Any]:
    """Wait until the page shows all this at once, and return what it shows."""
    found: dict[str, Any] = {}

    def is_shown() -> bool:
        page.wait_for_timeout(30)
        found.update(page.evaluate(SHOWN))
        return all(found[name] == value for name, value in wanted.items())

    wait_for(is_shown)
    return found


def assert_on_plan(shown: dict[str, Any]) -> None:
    """Check that picture and dot are those of the floor that is said to be shown."""
    _, size, scale, origin = PLANS[shown["shown"]]
    assert shown["width"] == size[0]
    x, u = shown["dot"]
    assert u == pytest.approx(origin[0] + x / scale, abs=0.1)


def test_the_plan_follows_the_walker_to_the_other_floor_and_back(
    server: Server, phone: Tab, tmp_path: Path
) -> None:
    page = phone.page
    wire = walk_about(server, phone)
    first = page.evaluate(SHOWN)["walker"]
    other = {"g": "u", "u": "g"}[first]
    for floor in (first, other, first):
        shown = until(page, shown=floor, walker=floor, width=PLANS[floor][1][0])
        assert shown["follows"]
        assert_on_plan(shown)
        playwright.expect(page.locator("#plan")).to_have_attribute("aria-label", re.compile(PLANS[floor][0]))
        keep_picture(page, tmp_path, f"floor-{floor}")
    # It was one session all the time.
    assert len({answer["session"] for answer in wire.answers}) == 1


def test_a_walker_looks_at_the_other_floor_and_comes_back(server: Server, phone: Tab, tmp_path: Path) -> None:
    page = phone.page
    wire = walk_about(server, phone)
    page.get_by_role("button", name="Upper floor").click()
    # While the walker is downstairs there is no dot, and it is said where they are.
    shown = until(page, shown="u", walker="g", width=PLANS["u"][1][0], dot=None)
    assert not shown["follows"]
    until(page, shown="u", walker="g", words="You are on another floor: Ground floor")
    keep_picture(page, tmp_path, "other-floor")
    # Wherever they go meanwhile, the floor that they look at stays.
    before = len(wire.answers)

    def was_on_both() -> bool:
        page.wait_for_timeout(30)
        assert page.evaluate(SHOWN)["shown"] == "u"
        return {answer["floor"] for answer in wire.answers[before:] if answer.get("located")} == {"g", "u"}

    wait_for(was_on_both)
    until(page, shown="u", walker="u", words="You are here")
    page.get_by_role("button", name="Ground floor").click()
    until(page, shown="g", walker="u", dot=None, words="You are on another floor: Upper floor")
    # Back to where they are, and from then on with them.
    page.locator("#follow").click()
    for floor in ("u", "g"):
        shown = until(page, shown=floor, walker=floor, follows=True, width=PLANS[floor][1][0])
        assert_on_plan(shown)
        assert shown["words"] == "You are here"


def test_who_drags_the_plan_keeps_the_floor_until_they_come_back(server: Server, phone: Tab) -> None:
    page = phone.page
    walk_about(server, phone)
    shown = until(page, shown="g", walker="g", width=PLANS["g"][1][0])
    box = page.locator("#plan").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 260, steps=4)
    page.mouse.up()
    shown = until(page, shown="g", walker="u")
    assert (shown["follows"], shown["dot"]) == (False, None)
    page.locator("#follow").click()
    assert_on_plan(until(page, shown="u", walker="u", follows=True, width=PLANS["u"][1][0]))
