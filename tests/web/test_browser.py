"""The pages in a real browser against a live server that asks for a key."""

from __future__ import annotations

import re

import httpx
import numpy as np
import pytest

from tests import scenes
from tests.web.live import KEY, Server, Tab

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
METERS_PER_PIXEL, ORIGIN_PX = 0.02, (20.0, 170.0)


def _give_key(page: playwright.Page) -> None:
    page.get_by_label("Key", exact=True).fill(KEY)
    page.get_by_role("button", name="Use this key").click()


def _photo(name: str, view: scenes.View) -> dict[str, object]:
    return {"name": name, "mimeType": "image/jpeg", "buffer": view.jpeg()}


def test_a_venue_without_a_map_says_so_in_plain_words(server: Server, tab: Tab) -> None:
    page = tab.page
    tab.open(server.url)
    playwright.expect(page.get_by_role("dialog")).to_contain_text("This server asks for a key")
    page.get_by_label("Key", exact=True).fill("wrong")
    page.get_by_role("button", name="Use this key").click()
    playwright.expect(page.get_by_role("dialog")).to_contain_text("The key was refused.")
    _give_key(page)

    # A name that would be markup if it were not put in as text.
    name = "<img src=x onerror=alert(1)>"
    page.locator("#new-venue").click()
    page.locator("#venue-name").fill(name)
    page.locator("#venue-name").fill("Gebäude Süd, Großes Café")
    playwright.expect(page.locator("#venue-id")).to_have_value("gebaeude-sued-grosses-cafe")
    page.locator("#venue-name").fill(name)
    page.locator("#venue-id").fill("empty")
    page.get_by_role("button", name="Add", exact=True).click()
    playwright.expect(page.locator("#venue option:checked")).to_have_text(name)

    page.locator("#photo").set_input_files(
        _photo("it's here.jpg", scenes.Room().view(scenes.pose_at(2, 1.5)))
    )
    page.get_by_role("button", name="Locate", exact=True).click()
    result = page.get_by_role("region", name="Result")
    playwright.expect(result).to_contain_text("Not located")
    playwright.expect(result).to_contain_text("This venue has no map yet.")
    curl = page.locator("#curl").text_content() or ""
    assert r"'image=@it'\''s here.jpg'" in curl
    assert "-F venue=empty" in curl
    assert "Bearer $ROOMFIX_KEY" in curl
    assert KEY not in curl

    page.locator("#photo").set_input_files(
        {"name": "no.jpg", "mimeType": "image/jpeg", "buffer": b"not an image"}
    )
    page.get_by_role("button", name="Locate", exact=True).click()
    answer = server.client.post("/locate", data={"venue": "empty"}, files={"image": b"not an image"})
    playwright.expect(page.locator("#locate-error")).to_have_text(answer.json()["detail"])
    # The browser notes a refused request by itself.
    tab.complaints[:] = [c for c in tab.complaints if str(answer.status_code) not in c]
    # Another photo: what was wrong with the one before is not said any more.
    page.locator("#photo").set_input_files(_photo("yes.jpg", scenes.Room().view(scenes.pose_at(2, 1.5))))
    playwright.expect(page.locator("#locate-error")).to_be_empty()


def test_floors_that_come_after_another_venue_was_chosen_are_not_shown(server: Server, tab: Tab) -> None:
    page = tab.page
    for venue in ("early", "late"):
        server.client.post("/venues", json={"id": venue, "name": f"Venue {venue}"}).raise_for_status()
        floor = {"name": f"Floor of {venue}", "level": 0, "z_min_m": 0.0, "z_max_m": 3.0}
        floor["plan_from_world"] = np.eye(4).tolist()
        server.client.put(f"/venues/{venue}/floors/g", json=floor).raise_for_status()
    held: list[playwright.Route] = []

    def hold(
        route: playwright.Route,
    ) -> None:  # Playwright marks its handlers, which a list's method doesn't allow.
        held.append(route)

    tab.open(server.url)
    _give_key(page)
    page.route("**/venues/late/floors", hold)
    page.locator("#venue").select_option("late")
    playwright.expect(page.locator("#floor-tabs")).not_to_contain_text("Floor of")
    page.locator("#venue").select_option("early")
    playwright.expect(page.locator("#floor-tabs")).to_contain_text("Floor of early")
    with page.expect_response("**/venues/late/floors"):
        held[0].continue_()
    page.evaluate("() => new Promise((done) => setTimeout(done))")
    playwright.expect(page.locator("#floor-tabs")).to_have_text("Floor of early")
    playwright.expect(page.locator("#floor-hint option")).to_have_text(["Any floor", "Floor of early"])


def test_every_view_opens_at_its_top(server: Server, tab: Tab) -> None:
    tab.page.set_viewport_size({"width": 400, "height": 300})
    tab.open(server.url)
    _give_key(tab.page)
    for view in ("locate", "maps", "floors", "keys"):
        tab.open(f"{server.url}/#{view}")
        tab.page.reload()
        playwright.expect(tab.page.locator(f"#view-{view}")).to_be_visible()
        assert tab.page.evaluate("document.documentElement.scrollHeight > innerHeight")
        assert tab.page.evaluate("scrollY") == 0, view
        assert tab.page.evaluate("document.getElementById(location.hash.slice(1)) === null")


def test_a_key_is_made_shown_once_and_revoked(server: Server, tab: Tab) -> None:
    page = tab.page
    if not server.client.get("/venues").json():
        server.client.post("/venues", json={"id": "shop", "name": "Shop"})
    tab.open(f"{server.url}/#keys")
    _give_key(page)
    playwright.expect(page.locator("#keys-list")).to_contain_text("no key yet")
    page.locator("#key-name").fill("Hall")
    page.locator("#key-scope").select_option("anchor")
    page.locator("#key-camera").fill("hall-camera")
    page.locator("#key-days").fill("30")
    page.get_by_role("button", name="Make the key").click()
    playwright.expect(page.locator("#new-key")).to_contain_text("only time")
    text = page.locator("#new-key pre").text_content() or ""
    assert text.startswith("rfk_")
    headers = {"Authorization": f"Bearer {text}"}
    pushed = httpx.post(f"{server.url}/anchors/hall-camera/frames", content=b"x", headers=headers)
    # Let in: there is no such camera.
    assert pushed.status_code == 404
    (key,) = server.client.get("/keys").json()
    assert (key["scope"], key["camera"], key["expires_at"] is None) == ("anchor", "hall-camera", False)
    playwright.expect(page.locator("#keys-list")).to_contain_text("camera hall-camera alone")
    playwright.expect(page.locator("#keys-list")).not_to_contain_text(text)
    page.get_by_role("button", name="Revoke Hall").click()
    playwright.expect(page.locator("#keys-list")).to_contain_text("revoked")
    refused = httpx.post(f"{server.url}/anchors/hall-camera/frames", content=b"x", headers=headers)
    assert refused.json()["code"] == "key_revoked"


def test_a_scan_becomes_a_map_and_a_photo_a_place_on_the_plan(server: Server, tab: Tab) -> None:
    room = scenes.Room()
    page = tab.page
    _floor_with_plan(server.client, "tiny", "Tiny room")
    tab.open(f"{server.url}/#maps")
    _give_key(page)
    page.locator("#venue").select_option("tiny")
    playwright.expect(page.locator("#maps-list")).to_contain_text("no map yet")

    page.locator("#build-form summary").click()
    page.locator("#more").fill("{not json")
    page.locator("#archive").set_input_files(
        {"name": "scan.zip", "mimeType": "application/zip", "buffer": _scan(room)}
    )
    page.get_by_role("button", name="Upload and build").click()
    playwright.expect(page.locator("#build-error")).to_contain_text("not JSON")
    page.locator("#more").fill('{"gravity": [0, 0, -1]}')
    page.locator("#scan-camera").fill(scenes.CAMERA_TEXT)
    page.get_by_role("button", name="Upload and build").click()
    playwright.expect(page.locator("#progress progress")).to_be_visible()
    playwright.expect(page.locator("#progress")).to_contain_text("Version 1 is built")
    playwright.expect(page.locator("#maps-list")).to_contain_text("Serving")

    page.get_by_role("link", name="Locate", exact=True).click()
    page.get_by_text("Camera and search options").click()
    page.locator("#camera").fill(scenes.CAMERA_TEXT)
    truth = scenes.query_poses()[1]
    page.locator("#photo").set_input_files(_photo("query.jpg", room.view(truth)))
    page.get_by_role("button", name="Locate", exact=True).click()
    result = page.get_by_role("region", name="Result")
    playwright.expect(result).to_contain_text("Located")
    playwright.expect(result).to_contain_text("Tiny room, ground")
    playwright.expect(page.locator("#plan-svg image")).to_have_attribute("href", re.compile("^blob:"))

    x, y, _ = truth.translation
    expected = np.array([ORIGIN_PX[0] + x / METERS_PER_PIXEL, ORIGIN_PX[1] - y / METERS_PER_PIXEL])
    drawn = _drawn_at(page)
    assert np.linalg.norm(drawn - expected) * METERS_PER_PIXEL < 0.1
    forward = truth.rotation[:, 2]
    heading = np.degrees(np.arctan2(forward[1], forward[0]))
    turned = page.locator("#plan-svg .mark.selected g g").get_attribute("transform") or ""
    # SVG turns clockwise, the heading counts the other way.
    shown = -float(re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", turned)[0])
    assert abs((shown - heading + 180) % 360 - 180) < 3

    # Zooming keeps the mark where it is on the plan.
    page.get_by_role("button", name="Zoom in").click()
    assert np.allclose(_drawn_at(page), drawn)


def test_a_build_that_cannot_work_shows_the_servers_reason(server: Server, tab: Tab) -> None:
    page = tab.page
    server.client.post("/venues", json={"id": "broken", "name": "Broken"})
    tab.open(f"{server.url}/#maps")
    _give_key(page)
    page.locator("#venue").select_option("broken")
    page.locator("#archive").set_input_files(
        {
            "name": "scan.zip",
            "mimeType": "application/zip",
            "buffer": scenes.zipped({"readme.txt": b"no scan"}),
        }
    )
    page.get_by_role("button", name="Upload and build").click()
    playwright.expect(page.locator("#progress")).to_contain_text("The build failed.")
    (build,) = server.client.get("/database/builds", params={"venue": "broken"}).json()
    playwright.expect(page.locator("#progress")).to_contain_text(build["error"])
    playwright.expect(page.locator("#builds")).to_contain_text(build["error"])


def test_events_are_read_whatever_the_pieces_they_come_in(server: Server, tab: Tab) -> None:
    tab.open(server.url)
    events = tab.page.evaluate(
        """async () => {
            const { eventData } = await import("/assets/js/sse.js");
            const first = ': ping\\r\\n\\r\\nevent: build\\r\\ndata: {"a":"ä"}\\r\\n\\r\\n';
            const text = first + 'data: 1\\ndata:2\\n\\ndata: lost';
            const bytes = new TextEncoder().encode(text);
            const all = [];
            for (const size of [1, 2, 7, bytes.length]) {
                const stream = new ReadableStream({ start(controller) {
                    for (let i = 0; i < bytes.length; i += size) controller.enqueue(bytes.slice(i, i + size));
                    controller.close();
                } });
                const found = [];
                for await (const data of eventData(stream)) found.push(data);
                all.push(found);
            }
            return all;
        }"""
    )
    assert events == [['{"a":"ä"}', "1\n2"]] * 4


def test_the_api_page_works_without_any_other_host(server: Server, tab: Tab) -> None:
    tab.open(f"{server.url}/docs")
    playwright.expect(tab.page.locator("#operations-locate-locateImage")).to_be_visible()
    playwright.expect(tab.page.locator("body")).not_to_contain_text("Unable to render")


def _scan(room: scenes.Room) -> bytes:
    return scenes.zipped(scenes.scan_files([room.view(pose) for pose in scenes.walk()]))


def _floor_with_plan(client: httpx.Client, venue: str, name: str) -> None:
    client.post("/venues", json={"id": venue, "name": name}).raise_for_status()
    floor = {"name": f"{name}, ground", "level": 0, "z_min_m": -0.5, "z_max_m": 3.0}
    floor["plan_from_world"] = np.eye(4).tolist()
    client.put(f"/venues/{venue}/floors/g", json=floor).raise_for_status()
    plan = scenes.encode(np.full((190, 240, 3), 240, np.uint8), ".png")
    fields = {"meters_per_pixel": METERS_PER_PIXEL, "origin_px": f"{ORIGIN_PX[0]},{ORIGIN_PX[1]}"}
    client.put(f"/venues/{venue}/floors/g/plan", data=fields, files={"image": plan}).raise_for_status()


def _drawn_at(page: playwright.Page) -> np.ndarray:
    moved = page.locator("#plan-svg .mark.selected > g").get_attribute("transform") or ""
    found = re.match(r"translate\((\S+) (\S+)\)", moved)
    assert found, moved
    return np.array([float(found[1]), float(found[2])])
