"""Every page and dialog by axe-core, at any width and zoom, in the dark, by keyboard; and how heavy pages are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.storage.db import Database
from tests import scenes
from tests.plans import area, collection, landmark, link
from tests.web.live import KEY, Server, Tab, live_server, watched_tab
from tests.web.studio_page import store_walk

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed")
BOARD_VIEWS = ("plan", "align", "draw", "cameras", "phones")
STUDIO_VIEWS = ("start", "scan", *BOARD_VIEWS, "try", "share")
START_VIEWS = ("locate", "maps", "floors", "keys")
# Page, and what is opened on it by a click: dialogs, and views that a fragment chooses.
PLACES = [
    *((f"/#{view}", None) for view in START_VIEWS),
    *((f"/studio#{view}", None) for view in STUDIO_VIEWS),
    ("/studio#start", "#new-venue"),
    ("/studio#plan", "#new-floor"),
    # The dialog that asks for a key.
    *((place, "key") for place in ("/", "/studio", "/go/house")),
    ("/#keys", "new key"),
    ("/studio#draw", "way"),
    ("/studio#cameras", "camera"),
    ("/studio#phones", "phone"),
    ("/studio#scan", "compare"),
    ("/go/house", None),
    ("/go/house", "search"),
    ("/go/none", None),
    ("/record/house", None),
    *(("/record/house", f"step-{step}") for step in ("film", "size", "build")),
]
# A small phone, and a screen of 1280 x 1024 at 200 %.
NARROW = ({"width": 320, "height": 568}, {"width": 640, "height": 512})
WIDE = {"width": 1280, "height": 900}
LIMITS_KB = {"/go/house": 150, "/record/house": 150, "/studio": 350, "/": 150}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue of two floors, a plan and features, without a map."""
    with live_server(tmp_path_factory.mktemp("axe")) as server:
        client = server.client
        client.post("/venues", json={"id": "house", "name": "House"}).raise_for_status()
        for level, name in enumerate(("Ground floor", "Upper floor")):
            floor = {"name": name, "level": level, "z_min_m": 3.0 * level, "z_max_m": 3.0 * level + 3}
            client.put(f"/venues/house/floors/{level}", json=floor).raise_for_status()
        image = scenes.encode(np.full((300, 400, 3), 250, np.uint8), ".png")
        fields = {"meters_per_pixel": 0.05, "origin_px": "0,299"}
        client.put("/venues/house/floors/0/plan", data=fields, files={"image": image}).raise_for_status()
        features = collection(
            area("hall", 1, 1, 9, 9), landmark("door", 2, 2), landmark("desk", 8, 8), link((2, 2), (8, 8))
        )
        client.put(
            "/venues/house/floors/1/features", json=collection(landmark("attic", 2, 2))
        ).raise_for_status()
        stairs = {"kind": "link", "mode": "stairs", "to_floor": "1", "to": "attic"}
        way = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [2, 2]}, "properties": stairs}
        features["features"].append(way)
        client.put("/venues/house/floors/0/features", json=features).raise_for_status()
        seen = {"id": "print", "region_px": [[40, 40], [90, 40], [90, 80]], "position": {"x": 5, "y": 5}}
        hall = {"venue": "house", "floor": "0", "position": {"x": 2, "y": 3}, "height_m": 2.5}
        hall |= {"camera": scenes.CAMERA_TEXT, "pois": [{**seen, "distance_m": 3.6}], "store_images": True}
        client.put("/anchors/hall", json=hall).raise_for_status()
        picture = scenes.Room().view(scenes.pose_at(1.4, 1.3)).jpeg()
        client.post("/anchors/hall/frames", content=picture).raise_for_status()
        database = Database(f"sqlite:///{server.folder}/data/roomfix.db")
        store_walk(database, share=True)
        database.close()
        yield server


def ask_for_key(page: Any) -> None:
    playwright.expect(page.locator("#key-dialog")).to_be_visible()


def make_key(page: Any) -> None:
    page.locator("#key-name").fill("The app of the museum, on the phones that are lent to visitors")
    page.get_by_role("button", name="Make the key").click()
    playwright.expect(page.locator("#new-key pre")).to_contain_text("rfk_")
    playwright.expect(page.locator("#keys-list .card")).to_have_count(1)


def choose_way(page: Any) -> None:
    page.get_by_text("All features", exact=True).click()
    page.get_by_role("button", name="link: stairs to Upper floor").click()
    playwright.expect(page.get_by_label("The way is")).to_be_visible()


def edit_camera(page: Any) -> None:
    page.get_by_role("button", name="Edit: hall").click()
    playwright.expect(page.locator("#picture .region.kept")).to_have_count(1)


def show_phones(page: Any) -> None:
    playwright.expect(page.locator("#phone-list li")).to_have_count(1)


def show_comparison(page: Any) -> None:
    # It is there once there are two maps; its fields are the same.
    page.evaluate("() => { document.getElementById('compare-form').hidden = false; }")


OPENED = {
    **{"key": ask_for_key, "new key": make_key, "way": choose_way},
    **{"camera": edit_camera, "phone": show_phones, "compare": show_comparison},
}


def visit(server: Server, tab: Tab, place: str, opened: str | None) -> None:
    """Go to a place with the key in hand, and open what is to be opened."""
    page = tab.page
    if opened != "key":
        page.add_init_script(f"sessionStorage.setItem('roomfix.key', '{KEY}')")
    tab.open(server.url + place)
    page.wait_for_load_state("networkidle")
    if opened in OPENED:
        OPENED[opened](page)
    elif opened == "search":
        # The button is there once the camera is; the dialog is the same.
        page.evaluate("() => { document.getElementById('tools').hidden = false; }")
        page.locator("#search").click()
    elif opened and opened.startswith("step-"):
        # The steps that follow need a camera and a server that builds; what they show is the same.
        page.evaluate(
            """(id) => {
                for (const each of document.querySelectorAll('[id^="step-"]')) each.hidden = each.id !== id;
                const more = '[id^="size-"], #go-link, #again, #record-new';
                for (const each of document.querySelectorAll(more)) each.hidden = false;
                document.querySelector('input[value="distance"]').click();
            }""",
            opened,
        )
    elif opened:
        page.locator(opened).click()
    page.wait_for_timeout(150)


@pytest.mark.parametrize(("place", "opened"), PLACES)
def test_a_place_is_accessible_and_fits(server: Server, browser: Any, place: str, opened: str | None) -> None:
    """axe-core finds nothing in light and in dark colours, and nothing scrolls sideways on narrow screens."""
    found, wide = [], []
    with watched_tab(browser, ("401", "404"), viewport=NARROW[0], locale="en-US") as tab:
        page = tab.page
        visit(server, tab, place, opened)
        for size in NARROW:
            page.set_viewport_size(size)
            width = page.evaluate("() => document.documentElement.scrollWidth")
            if width > size["width"]:
                wide.append((size, width, page.evaluate(WIDEST)))
        page.set_viewport_size(WIDE)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            for violation in axe.Axe().run(page).response["violations"]:
                nodes = [node["html"][:160] for node in violation["nodes"][:4]]
                found.append((scheme, violation["id"], nodes))
    assert not wide, "\n".join(map(str, wide))
    assert not found, "\n".join(map(str, found))


# The elements that reach farthest to the right, to name what is too wide.
WIDEST = """() => [...document.querySelectorAll("body *")]
    .filter((e) => e.checkVisibility() && e.getBoundingClientRect().right > innerWidth + 1)
    .slice(-3).map((e) => e.outerHTML.slice(0, 120))"""


@pytest.mark.parametrize(
    "place", ["/", "/go/house", "/record/house", *(f"/studio#{view}" for view in STUDIO_VIEWS)]
)
def test_every_control_is_reached_by_tab_and_has_a_name(server: Server, browser: Any, place: str) -> None:
    with watched_tab(browser, locale="en-US") as tab:
        visit(server, tab, place, None)
        page = tab.page
        wanted = page.evaluate(
            """() => [...document.querySelectorAll("button, a[href], input, select, textarea, summary, [tabindex='0']")]
                .filter((e) => e.checkVisibility({ visibilityProperty: true, opacityProperty: false })
                    && !e.disabled && !e.closest("[inert]") && e.type !== "radio")
                .map((e, i) => { e.dataset.wanted = i; return e.outerHTML.slice(0, 100); })"""
        )
        assert len(wanted) > 1
        reached: set[str | None] = set()
        page.evaluate("() => document.activeElement.blur()")
        for _ in range(3 * len(wanted) + 10):
            page.keyboard.press("Tab")
            reached.add(page.evaluate("() => document.activeElement.dataset.wanted ?? null"))
            if len(reached - {None}) == len(wanted):
                break
        missed = [html for i, html in enumerate(wanted) if str(i) not in reached]
        assert not missed


@pytest.mark.parametrize("place", LIMITS_KB)
def test_the_first_load_is_light_and_from_here_only(server: Server, browser: Any, place: str) -> None:
    with watched_tab(browser, locale="en-US") as tab:
        sizes: dict[str, int] = {}
        tab.page.on("requestfinished", lambda request: sizes.update({request.url: _weight(request)}))
        tab.page.add_init_script(f"sessionStorage.setItem('roomfix.key', '{KEY}')")
        tab.open(server.url + place)
        tab.page.wait_for_load_state("networkidle")
        pages = {url: size for url, size in sizes.items() if "/assets/" in url or url.endswith(place)}
        assert len(pages) > 5
        assert sum(pages.values()) < 1000 * LIMITS_KB[place]
        print(f"{place}: {sum(pages.values()) / 1000:.1f} kB in {len(pages)} files")


def _weight(request: Any) -> int:
    sizes = request.sizes()
    return int(sizes["responseBodySize"] + sizes["responseHeadersSize"])
