"""The way of a newcomer through the studio, from an empty server to a located photo, with hands that a test chooses."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.web.hands import Hands, polycam_scan
from tests.web.live import Server
from tests.web.pictures import keep_picture
from tests.web.studio_page import METERS_PER_PIXEL, plan_pdf, spot

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# Where the monitoring camera hangs.
MONITOR = scenes.pose_at(1.2, 1.4, 2.1, 5.0, -12.0)
# The plan image shows 6 m by 5 m, the room's corner at (1, 0.5) m, turned by a quarter: plan = (1 + 3 - y, 0.5 + x).
EXPECTED = np.array([[0, -1, 4.0], [1, 0, 0.5]])


def go_the_whole_way(server: Server, hands: Hands, tmp_path: Path) -> None:
    """From the server without a venue to a located photo and a printed code; what is stored is what was meant."""
    page = hands.page
    steps = page.locator("#steps li")
    playwright.expect(steps).to_have_count(7)
    playwright.expect(page.locator("#steps .done")).to_have_count(0)
    hands.click(page.locator("#steps").get_by_role("button", name="Add a venue"))
    hands.type(page.locator("#venue-name"), "House")
    hands.press("Add")
    playwright.expect(page.locator("#steps .done")).to_have_count(1)
    room = scenes.Room()
    build(hands, room, tmp_path)
    show_the_plan(server, hands, tmp_path)
    align(server, hands, tmp_path)
    draw(server, hands, tmp_path)
    hang_a_camera(server, hands, room)
    try_a_photo(server, hands, room, tmp_path)
    share(server, hands, tmp_path)
    hands.visit("Start")
    playwright.expect(page.locator("#steps .done")).to_have_count(7)


def build(hands: Hands, room: scenes.Room, tmp_path: Path) -> None:
    """Upload a scan as a phone's app exports it, and wait until its map serves."""
    page = hands.page
    hands.visit("Scan")
    scan = polycam_scan([room.view(pose) for pose in scenes.walk()])
    hands.file(page.locator("#archive"), "scan.zip", "application/zip", scan)
    hands.press("Upload and build")
    playwright.expect(page.locator("#report")).to_contain_text("Report on version 1")
    playwright.expect(page.locator("#report")).to_contain_text("of its own frames are located")
    keep_picture(page, tmp_path, "scan")
    playwright.expect(page.locator("#versions")).to_contain_text("Serving")
    playwright.expect(page.locator(".top-view")).to_have_attribute("src", re.compile("^blob:"))


def plan_from_world(server: Server) -> np.ndarray:
    """Return the stored (2, 3) of the plan."""
    matrix = np.array(server.client.get("/venues/house/floors/0").json()["plan_from_world"])
    return matrix[:2, [0, 1, 3]]


def show_the_plan(server: Server, hands: Hands, tmp_path: Path) -> None:
    """Add a floor, choose the second page of a PDF as its plan, and click two points whose distance is known."""
    page = hands.page
    hands.visit("Plan")
    hands.press("Add a floor")
    hands.type(page.locator("#floor-name"), "Ground floor")
    hands.press("Add floor")
    playwright.expect(page.locator("#floor option:checked")).to_have_text("Ground floor")
    hands.file(page.locator("#plan-image"), "plan.pdf", "application/pdf", plan_pdf())
    shown = page.locator("#board-svg image")
    playwright.expect(shown).to_have_attribute("href", re.compile("^blob:"))
    first = shown.get_attribute("href")
    hands.type(page.get_by_label("Page", exact=True), "2")
    hands.leave_field()
    playwright.expect(shown).not_to_have_attribute("href", first)
    # The room is 3 m wide on the plan.
    hands.spot(1.0, 2.0)
    hands.spot(4.0, 2.0)
    hands.type(page.locator("#distance"), "3")
    playwright.expect(page.locator("#scale-words")).to_contain_text("m per pixel")
    keep_picture(page, tmp_path, "plan")
    hands.press("Save plan")
    playwright.expect(page.locator("#board-error")).to_contain_text("The plan is stored.")
    stored = server.client.get("/venues/house/floors/0").json()["plan"]
    assert stored["meters_per_pixel"] == pytest.approx(METERS_PER_PIXEL, rel=0.01)


def align(server: Server, hands: Hands, tmp_path: Path) -> None:
    """Lay the scan over the plan by dragging, then by pairs."""
    page = hands.page
    hands.visit("Align")
    playwright.expect(page.locator("#board-svg image.scan")).to_be_visible()
    hands.press("Turn")
    x, y = (float(page.locator(f"#shift-{axis}").input_value()) for axis in "xy")
    u, v = spot(page, x, y)
    hands.drag((u + 200, v), (u + 100, v - 150), (u, v - 200))
    assert float(page.locator("#turn").input_value()) == pytest.approx(90, abs=1)
    hands.press("Move")
    world = drawn_middle(page)
    target = EXPECTED @ [*world, 1]
    x, y = (float(page.locator(f"#shift-{axis}").input_value()) for axis in "xy")
    hands.drag(spot(page, x, y), spot(page, *target))
    keep_picture(page, tmp_path, "align")
    hands.press("Save alignment")
    playwright.expect(page.locator("#board-error")).to_contain_text("The alignment is stored.")
    found = plan_from_world(server)
    angle = np.degrees(np.arctan2(found[1, 0], found[0, 0]))
    assert abs(angle - 90) < 1
    corners = np.array([[0, 0, 1], [4, 0, 1], [4, 3, 1], [0, 3, 1]]).T
    assert np.linalg.norm(found @ corners - EXPECTED @ corners, axis=0).mean() < 0.15

    # Pairs: each scan point where it is drawn now, each plan point where it belongs; one is wrong.
    hands.press("Add a pair")
    before = found
    wrong = (0.8, 0.5)
    for world_point in ([0.5, 0.5, 1], [3.5, 0.5, 1], [3.5, 2.5, 1], [0.5, 2.5, 1], [2.0, 1.5, 1]):
        hands.spot(*(before @ world_point))
        truth = EXPECTED @ world_point
        hands.spot(*(truth + wrong if world_point[:2] == [2.0, 1.5] else truth))
    pairs = page.locator("#pairs li")
    playwright.expect(pairs).to_have_count(5)
    playwright.expect(pairs.nth(4)).to_contain_text("contradicts the others")
    hands.press("Remove pair 5")
    hands.press("Fit to the pairs")
    fitted = page.locator("#turn").input_value()
    hands.undo()
    hands.redo()
    # What is not saved comes back.
    hands.reload()
    playwright.expect(page.locator("#board-error")).to_contain_text(
        "The alignment that you didn't save is back"
    )
    playwright.expect(page.locator("#turn")).to_have_value(fitted)
    playwright.expect(pairs).to_have_count(4)
    hands.press("Save alignment")
    playwright.expect(page.locator("#board-error")).to_contain_text("The pairs are")
    found = plan_from_world(server)
    assert np.linalg.norm(found @ corners - EXPECTED @ corners, axis=0).max() < 0.03


def drawn_middle(page: Any) -> np.ndarray:
    """Return the world point that the middle of the scan's picture shows."""
    return np.array(
        page.evaluate(
            """async () => {
                const { ScanPoints } = await import("/assets/js/studio/scan-image.js");
                const { z_min, z_max } = { z_min: Number(document.getElementById("z-min").value),
                                           z_max: Number(document.getElementById("z-max").value) };
                const i = await (await ScanPoints.of("house", 1)).drawn(z_min, z_max);
                return [i.x + i.width * i.metresPerPx / 2, i.y - i.height * i.metresPerPx / 2];
            }"""
        )
    )


def draw(server: Server, hands: Hands, tmp_path: Path) -> None:
    """Draw an area, two landmarks and a link; undo, redo, reload, save; try the route."""
    page = hands.page
    hands.visit("Draw")
    hands.press("Landmark")
    for x, y, name in ((1.5, 1.5, "Door"), (3.5, 4.0, "Window")):
        hands.spot(x, y)
        hands.write(name)
        hands.key("Enter")
    hands.press("Link")
    # Close to the landmarks: the ends snap to them.
    hands.spot(1.53, 1.52)
    hands.spot(2.5, 3.0)
    hands.spot(3.48, 4.03)
    hands.finish()
    hands.press("Area")
    for x, y in ((1.1, 0.6), (3.9, 0.6), (3.9, 4.4), (1.1, 4.4)):
        hands.spot(x, y)
    hands.finish()
    hands.write("Hall")
    hands.key("Enter")
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    hands.undo()
    hands.undo()
    playwright.expect(page.locator("#feature-list li")).to_have_count(3)
    hands.redo()
    hands.redo()
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    hands.reload()
    playwright.expect(page.locator("#board-error")).to_contain_text("What you drew and didn't save is back")
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    keep_picture(page, tmp_path, "draw")
    hands.press("Save")
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    features = server.client.get("/venues/house/floors/0/features").json()["features"]
    kinds = sorted(each["properties"]["kind"] for each in features)
    assert kinds == ["area", "landmark", "landmark", "link"]
    ends = next(e for e in features if e["properties"]["kind"] == "link")["geometry"]["coordinates"]
    points = [e["geometry"]["coordinates"] for e in features if e["properties"]["kind"] == "landmark"]
    assert [ends[0], ends[-1]] == points
    assert {each["properties"].get("name") for each in features} >= {"Door", "Window", "Hall"}

    hands.press("Try a route")
    hands.spot(1.5, 1.5)
    hands.spot(3.5, 4.0)
    playwright.expect(page.locator("#draw-words")).to_contain_text("Window. You have arrived.")
    playwright.expect(page.locator("polyline.route")).to_have_count(1)
    route = server.client.get("/venues/house/route", params={"from": "0:1.5,1.5", "to": "0:3.5,4.0"}).json()
    shown = page.locator("#draw-words").text_content() or ""
    assert shown.startswith(f"{route['distance_m']:.1f} m: ")
    assert all(step["instruction"] in shown for step in route["steps"])


def hang_a_camera(server: Server, hands: Hands, room: scenes.Room) -> None:
    """Place a monitoring camera by its picture, mark what it sees, and let the map find its pose."""
    page = hands.page
    pose, view = MONITOR, room.view(MONITOR)
    hands.visit("Cameras")
    playwright.expect(page.locator("#board-svg image")).to_have_count(1)
    playwright.expect(page.locator("#cameras li")).to_have_text("None yet.")
    hands.file(page.locator("#camera-picture"), "p.png", "image/png", view.png())
    playwright.expect(page.locator("#picture image")).to_have_count(1)
    hands.press("Find them by the map")
    playwright.expect(page.locator("#board-error")).to_contain_text("where the camera hangs")
    hands.type(page.locator("#camera-id"), "corner")
    u, v = 0.4, 0.45
    hands.mark(page.locator("#picture"), (u - 0.08, v - 0.1), (u + 0.08, v + 0.1))
    height, width = view.rgb.shape[:2]
    pixel = np.array([[u * width, v * height]])
    seen = scenes.CAMERA.unproject(pixel, np.array([view.depth_m[int(v * height), int(u * width)]]))
    target = pose.apply(seen)[0]
    hands.type(page.locator("#poi-name"), "print")
    hands.press("The place")
    hands.spot(*(EXPECTED @ [*target[:2], 1]))
    hands.type(page.locator("#poi-distance"), f"{np.linalg.norm(target - pose.translation):.2f}")
    hands.press("Save camera")
    playwright.expect(page.locator("#board-error")).to_contain_text("The camera is stored.")
    hands.press("Find it in the map: corner")
    playwright.expect(page.locator("#board-error")).to_contain_text("is found in the map")
    anchor = server.client.get("/anchors/corner").json()
    expected = EXPECTED @ [*pose.translation[:2], 1]
    found = [anchor["calibration"]["plan"][axis] for axis in "xy"]
    assert np.linalg.norm(found - expected) < 0.1
    assert np.linalg.norm([anchor["position"][axis] for axis in "xy"] - expected) < 0.2


def try_a_photo(server: Server, hands: Hands, room: scenes.Room, tmp_path: Path) -> None:
    """Locate a photo; the answer is the API's, and the matches are drawn."""
    page = hands.page
    hands.visit("Try")
    pose = scenes.query_poses()[1]
    photo = room.view(pose).jpeg()
    hands.file(page.locator("#photo"), "photo.jpg", "image/jpeg", photo)
    hands.type(page.locator("#photo-camera"), scenes.CAMERA_TEXT)
    hands.press("Locate")
    result = page.locator("#try-result")
    playwright.expect(result).to_contain_text("Located")
    x, y = EXPECTED @ [*pose.translation[:2], 1]
    shown = re.search(r"At (-?[\d.]+), (-?[\d.]+) m", result.text_content() or "")
    assert shown
    assert np.hypot(float(shown[1]) - x, float(shown[2]) - y) < 0.1
    fields = {"venue": "house", "camera": scenes.CAMERA_TEXT, "matches": "true"}
    answer = server.client.post("/locate", data=fields, files={"image": photo}).json()
    assert shown[0] == f"At {answer['plan']['x']:.2f}, {answer['plan']['y']:.2f} m"
    playwright.expect(result).to_contain_text(f"{answer['inliers']} of {answer['matches']} matches agree")
    playwright.expect(page.locator("line.match").nth(10)).to_be_attached()
    keep_picture(page, tmp_path, "try")


def share(server: Server, hands: Hands, tmp_path: Path) -> None:
    """Make the QR code of the phone page, and a key for the monitoring camera."""
    page, client = hands.page, server.client
    hands.visit("Share")
    hands.type(page.locator("#address"), "https://house.example:8443/")
    playwright.expect(page.locator("#print")).to_be_hidden()
    hands.press("Make the code")
    playwright.expect(page.locator("#qr")).to_be_visible()
    playwright.expect(page.locator("#print")).to_be_visible()
    keep_picture(page, tmp_path, "share")
    link = page.locator("#go-link").get_attribute("href") or ""
    assert re.fullmatch(r"https://house\.example:8443/go/house#token=\S{20,}", link)
    token = {"Authorization": f"Bearer {link.partition('#token=')[2]}"}
    assert client.get("/venues/house", headers=token).status_code == 200
    assert client.get("/venues/house/maps/1/points", headers=token).status_code == 403

    hands.click(page.get_by_role("link", name="Keys", exact=True))
    hands.type(page.locator("#key-name"), "Camera in the corner")
    hands.choose(page.locator("#key-scope"), "anchor")
    hands.type(page.locator("#key-camera"), "corner")
    hands.press("Make the key")
    playwright.expect(page.locator("#new-key")).to_contain_text("only time")
    key = {"Authorization": f"Bearer {page.locator('#new-key pre').text_content()}"}
    picture = scenes.Room().view(MONITOR).jpeg()
    assert client.post("/anchors/corner/frames", content=picture, headers=key).status_code == 200
    assert client.get("/anchors/corner", headers=key).status_code == 403
    hands.back()
    playwright.expect(page.get_by_role("navigation", name="Steps")).to_be_visible()
