"""The studio in a real browser: the whole way from an empty server to a QR code, and scans that are refused."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import scenes
from tests.server import wait_for
from tests.web.hands import Hands
from tests.web.live import Server, Tab, live_server
from tests.web.newcomer import go_the_whole_way
from tests.web.studio_page import OPENING_ACTIONS, open_studio, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# What the whole way takes, as `Hands` counts, and where that is written down.
ACTIONS = 115
# The pace of somebody who has not seen the pages before, and how long the whole way may take, waiting left out.
SECONDS_AN_ACTION = 3
PAGES = Path(__file__).parents[2] / "docs" / "pages.md"
LONGEST_S = 360


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that has nothing yet."""
    with live_server(tmp_path_factory.mktemp("studio")) as server:
        yield server


@pytest.fixture
def studio(browser: Any, server: Server) -> Iterator[Tab]:
    """The studio, opened with the key."""
    with open_studio(browser, server) as tab:
        yield tab


def test_the_way_of_a_newcomer(server: Server, studio: Tab, tmp_path: Path) -> None:
    """By mouse and keyboard alone, without a word of JSON, in fewer actions than fit into six minutes."""
    hands = Hands(studio.page, OPENING_ACTIONS)
    go_the_whole_way(server, hands, tmp_path)
    assert hands.actions == ACTIONS
    assert ACTIONS * SECONDS_AN_ACTION < LONGEST_S
    assert f"**{ACTIONS} actions**" in PAGES.read_text(encoding="utf-8")


def test_a_refused_scan_is_explained_and_repaired_by_a_button(
    server: Server, studio: Tab, tmp_path: Path
) -> None:
    page = studio.page
    visit(page, "Scan")
    room = scenes.Room()
    files = scenes.scan_files([room.view(pose) for pose in scenes.walk()[:8]])
    lines = files["groundtruth.txt"].decode().splitlines()
    # Quaternions with w first, as other tools write them.
    turned = [lines[0]] + [" ".join([*(row := line.split())[:4], row[7], *row[4:7]]) for line in lines[1:]]
    files["groundtruth.txt"] = ("\n".join(turned) + "\n").encode()
    archive = {"name": "scan.zip", "mimeType": "application/zip", "buffer": scenes.zipped(files)}
    page.locator("#archive").set_input_files(archive)
    page.get_by_text("Options", exact=True).click()
    page.locator("#scan-options").fill(f'{{"camera": [{scenes.CAMERA_TEXT}], "gravity": [0, 0, -1]}}')
    page.get_by_role("button", name="Upload and build").click()
    report = page.locator("#report")
    playwright.expect(report).to_contain_text("The scan was refused")
    report.get_by_role("button", name="Repair and build again").click()
    playwright.expect(report).to_contain_text("Repaired:")

    # Two versions of the same room differ by little but their keyframes.
    page.get_by_role("button", name="Compare", exact=True).click()
    compared = page.locator("#compare-result")
    playwright.expect(compared.locator("figcaption")).to_contain_text("% of the ground is in both")
    keyframes = [map_["statistics"]["keyframes"] for map_ in server.client.get("/venues/house/maps").json()]
    playwright.expect(compared.locator("tbody tr").first).to_have_text(
        re.compile(rf"Keyframes\s*{keyframes[1]}\s*{keyframes[0]}")
    )
    page.screenshot(path=tmp_path / "compare.png", full_page=True)

    # The version before can serve again, and the newer one be deleted.
    newest = server.client.get("/venues/house/maps").json()[0]["version"]
    page.get_by_role("button", name="Serve this one").first.click()
    playwright.expect(page.locator(".map.active")).not_to_contain_text(f"Version {newest}")
    page.get_by_role("button", name="Delete", exact=True).first.click()
    playwright.expect(page.locator("#versions")).not_to_contain_text(f"Version {newest}")
    wait_for(lambda: server.client.get("/venues/house/maps").json()[0]["version"] < newest)
    # What is being fetched of a version while it is deleted is a 404.
    studio.complaints[:] = [each for each in studio.complaints if "404" not in each]
