"""The studio's report on frames that a build left out, with their pictures, in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import scenes
from tests.built_maps import publish
from tests.faulty_scan import BLURRED, WITHOUT_DEPTH, faulty_scan
from tests.server import QUICK
from tests.web.live import KEY, Server, Tab, live_server
from tests.web.pictures import keep_picture
from tests.web.studio_page import open_studio, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed")
OPTIONS = {**QUICK, "camera": scenes.CAMERA_TEXT}
# A file name that a page must not take for markup.
MARKUP = "<b>2</b>"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, views: list[scenes.View]) -> Iterator[Server]:
    """A server whose venue `house` has a map of a scan with such frames; that of `plain` was built without pictures,
    and nothing was left out of the scan of `good`."""
    files = faulty_scan(views)
    first = f"rgb/{WITHOUT_DEPTH[0] / 10:.6f}.png"
    strange = first.replace("/0.2", f"/{MARKUP.replace('/', '')}0.2")
    files[strange] = files.pop(first)
    files["rgb.txt"] = files["rgb.txt"].replace(first.encode(), strange.encode())
    faulty = scenes.zipped(files)
    scans = {
        "house": (faulty, OPTIONS),
        "plain": (faulty, {**OPTIONS, "store_images": False}),
        "good": (scenes.zipped(scenes.scan_files(views[:12])), OPTIONS),
    }
    with live_server(tmp_path_factory.mktemp("left-out")) as server:
        for venue, scan in scans.items():
            server.client.post("/venues", json={"id": venue, "name": venue.title()}).raise_for_status()
            publish(server.folder / "data", venue, [scan])
        yield server


@pytest.fixture
def studio(browser: Any, server: Server) -> Iterator[Tab]:
    """The studio, opened with the key."""
    with open_studio(browser, server) as tab:
        yield tab


def report_on(page: Any, venue: str) -> Any:
    """Return the report on a venue's newest build, shown."""
    page.locator("#venue").select_option(venue)
    visit(page, "Scan")
    report = page.locator("#report")
    playwright.expect(report).to_contain_text("Report on version 1")
    return report


def test_frames_are_told_by_reason_and_shown(studio: Tab, tmp_path: Path) -> None:
    page = studio.page
    report = report_on(page, "house")
    total, number = len(scenes.walk()), len(BLURRED) + len(WITHOUT_DEPTH)
    playwright.expect(report.locator("h3")).to_have_text(f"{number} of {total} frames were left out")
    playwright.expect(report.locator("h4")).to_have_text(
        [f"{len(WITHOUT_DEPTH)} have no depth", f"{len(BLURRED)} are blurred"]
    )
    no_depth, blurred = report.locator(".left-out-group").all()
    playwright.expect(no_depth).to_contain_text("The depth sensor gave no image")
    playwright.expect(no_depth.locator("img")).to_have_count(6)
    playwright.expect(blurred.locator("figcaption strong")).to_have_text(["0:00", "0:00"])
    playwright.expect(blurred.locator(".name")).to_have_text([f"{row / 10:.6f}.png" for row in BLURRED])
    for image in report.locator(".strip img").all():
        playwright.expect(image).to_have_attribute("src", re.compile("^blob:"))
        playwright.expect(image).to_have_js_property("naturalWidth", 240)
    # All that are not shown are named; no name is taken for markup.
    no_depth.get_by_text("All names").click()
    playwright.expect(no_depth.locator("li:visible").filter(has_text="rgb/")).to_have_count(
        len(WITHOUT_DEPTH)
    )
    playwright.expect(no_depth.locator(".name").first).to_contain_text("<b>2<b>0.2")
    assert report.locator("b").count() == 0
    keep_picture(page, tmp_path, "left-out")


def test_a_map_without_pictures_has_the_words_alone(studio: Tab) -> None:
    report = report_on(studio.page, "plain")
    playwright.expect(report.locator("h4")).to_have_count(2)
    assert report.locator("img").count() == 0
    playwright.expect(report.get_by_text("All names")).to_have_count(2)


def test_of_a_scan_of_good_frames_nothing_is_said(studio: Tab) -> None:
    page = studio.page
    with page.expect_response(re.compile("/left-out$")) as asked:
        report = report_on(page, "good")
    assert asked.value.json()["left_out"] == 0
    playwright.expect(page.locator("#versions img.top-view")).to_have_attribute("src", re.compile("^blob:"))
    assert report.locator("h3").count() == 0


def test_a_picture_that_the_store_has_lost_is_not_a_broken_image(browser: Any, server: Server) -> None:
    with open_studio(browser, server) as studio:
        studio.page.route(re.compile(r"/left-out/0$"), lambda route: route.abort())
        report = report_on(studio.page, "house")
        playwright.expect(report.locator(".strip li")).to_have_count(6 + len(BLURRED))
        playwright.expect(report.locator(".strip img")).to_have_count(5 + len(BLURRED))
        studio.complaints[:] = [each for each in studio.complaints if "ERR_FAILED" not in each]


@pytest.mark.parametrize(
    ("language", "heading", "words"),
    [
        ("en", "Record a scan of House", ["Not connected with the others: 7. Film", "Blurred: 2. Move", "A warning"]),
        ("de", "House aufnehmen", ["Nicht mit den anderen verbunden: 7. Filmen", "Verwischt: 2. Gehen", "A warning"]),
    ],
)  # fmt: skip
def test_whoever_films_is_told_in_their_language(
    server: Server, tab: Tab, language: str, heading: str, words: list[str]
) -> None:
    tab.open(f"{server.url}/record/house?language={language}#token={KEY}")
    playwright.expect(tab.page.get_by_role("heading").first).to_have_text(heading)
    # What the server answers of a build that has left frames out; a reason of a later server is passed over.
    tab.page.evaluate(
        """async () => {
            const { showEnd } = await import("/assets/js/record/build.js");
            const left_out = { unconnected: 7, blurred: 2, poor_image: 0, of_tomorrow: 3 };
            showEnd({ state: "succeeded", warnings: ["A warning"], camera: null, left_out }, null, () => {});
        }"""
    )
    playwright.expect(tab.page.locator("#warnings li")).to_contain_text(words)
    assert tab.page.locator("#warnings li").count() == len(words)


def test_the_report_is_accessible_and_fits_a_small_phone(studio: Tab, tmp_path: Path) -> None:
    page = studio.page
    page.set_viewport_size({"width": 320, "height": 568})
    report = report_on(page, "house")
    playwright.expect(report.locator(".strip img").last).to_have_attribute("src", re.compile("^blob:"))
    report.get_by_text("All names").click()
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 320
    report.screenshot(path=tmp_path / "left-out-phone.png")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert axe.Axe().run(page).response["violations"] == []
