"""The studio in a real browser: the whole way from an empty server to a QR code, by mouse and by keyboard."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests import scenes
from tests.server import wait_for
from tests.web.live import Server, Tab, live_server
from tests.web.pictures import keep_picture
from tests.web.studio_page import METERS_PER_PIXEL, SIZE_PX, click, open_studio, spot, visit

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# The plan image shows 6 m by 5 m, the room's corner at (1, 1) m, turned by a quarter: plan = (1 + 3 - y, 1 + x).
EXPECTED = np.array([[0, -1, 4.0], [1, 0, 1.0]])


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


def plan_pdf() -> bytes:
    """Return the plan as the second page of a PDF, of as many pixels as the server draws it with."""
    image = np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8)
    # The room's walls.
    left, right, low, high = 100, 400, SIZE_PX[1] - 100, SIZE_PX[1] - 500
    image[max(high, 0) : low, left : left + 3] = image[max(high, 0) : low, right : right + 3] = 0
    image[low : low + 3, left:right] = 0
    pages = [Image.fromarray(np.full_like(image, 255)), Image.fromarray(image)]
    file = io.BytesIO()
    pages[0].save(file, "pdf", save_all=True, append_images=pages[1:], resolution=150)
    return file.getvalue()


def plan_from_world(server: Server) -> np.ndarray:
    matrix = np.array(server.client.get("/venues/house/floors/0").json()["plan_from_world"])
    return matrix[:2, [0, 1, 3]]


def test_the_way_of_a_newcomer(server: Server, studio: Tab, tmp_path: Path) -> None:
    page, client = studio.page, server.client
    steps = page.locator("#steps li")
    playwright.expect(steps).to_have_count(7)
    playwright.expect(page.locator("#steps .done")).to_have_count(0)
    page.locator("#steps").get_by_role("button", name="Add a venue").click()
    page.locator("#venue-name").fill("House")
    page.get_by_role("button", name="Add", exact=True).click()
    playwright.expect(page.locator("#steps .done")).to_have_count(1)

    # A scan whose poses are stated the wrong way around is refused, and repaired by a button.
    visit(page, "Scan")
    room = scenes.Room()
    views = [room.view(pose) for pose in scenes.walk()]
    scan = scenes.zipped(scenes.scan_files(views))
    archive = {"name": "scan.zip", "mimeType": "application/zip", "buffer": scan}
    page.locator("#archive").set_input_files(archive)
    page.get_by_text("Options", exact=True).click()
    page.locator("#scan-options").fill(f'{{"camera": [{scenes.CAMERA_TEXT}], "gravity": [0, 0, -1]}}')
    page.get_by_role("button", name="Upload and build").click()
    playwright.expect(page.locator("#report")).to_contain_text("Report on version 1")
    playwright.expect(page.locator("#report")).to_contain_text("of its own frames are located")
    keep_picture(page, tmp_path, "scan")
    playwright.expect(page.locator("#versions")).to_contain_text("Serving")
    playwright.expect(page.locator(".top-view")).to_have_attribute("src", re.compile("^blob:"))

    show_the_plan(server, page, tmp_path)
    align(server, page, tmp_path)
    draw(server, page, tmp_path)
    try_a_photo(page, room, tmp_path)

    visit(page, "Share")
    page.locator("#address").fill("https://house.example:8443/")
    page.get_by_role("button", name="Make the code").click()
    playwright.expect(page.locator("#qr")).to_be_visible()
    keep_picture(page, tmp_path, "share")
    link = page.locator("#go-link").get_attribute("href") or ""
    assert re.fullmatch(r"https://house\.example:8443/go/house#token=\S{20,}", link)
    token = {"Authorization": f"Bearer {link.partition('#token=')[2]}"}
    assert client.get("/venues/house", headers=token).status_code == 200
    assert client.get("/venues/house/maps/1/points", headers=token).status_code == 403

    visit(page, "Start")
    playwright.expect(page.locator("#steps .done")).to_have_count(7)


def show_the_plan(server: Server, page: Any, tmp_path: Path) -> None:
    """Add a floor, choose the second page of a PDF as its plan, and click two points whose distance is known."""
    visit(page, "Plan")
    page.get_by_role("button", name="Add a floor").click()
    page.locator("#floor-name").fill("Ground floor")
    page.locator("#floor-form").get_by_role("button", name="Add floor").click()
    playwright.expect(page.locator("#floor option:checked")).to_have_text("Ground floor")
    page.locator("#plan-image").set_input_files(
        {"name": "plan.pdf", "mimeType": "application/pdf", "buffer": plan_pdf()}
    )
    shown = page.locator("#board-svg image")
    playwright.expect(shown).to_have_attribute("href", re.compile("^blob:"))
    first = shown.get_attribute("href")
    page.get_by_label("Page", exact=True).fill("2")
    page.keyboard.press("Tab")
    playwright.expect(shown).not_to_have_attribute("href", first)
    # The room is 3 m wide on the plan.
    click(page, 1.0, 2.0)
    click(page, 4.0, 2.0)
    page.locator("#distance").fill("3")
    playwright.expect(page.locator("#scale-words")).to_contain_text("m per pixel")
    keep_picture(page, tmp_path, "plan")
    page.get_by_role("button", name="Save plan").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The plan is stored.")
    stored = server.client.get("/venues/house/floors/0").json()["plan"]
    assert stored["meters_per_pixel"] == pytest.approx(METERS_PER_PIXEL, rel=0.01)


def align(server: Server, page: Any, tmp_path: Path) -> None:
    """Lay the scan over the plan by dragging, then by pairs."""
    visit(page, "Align")
    playwright.expect(page.locator("#board-svg image.scan")).to_be_visible()
    turn, box = page.get_by_role("button", name="Turn"), page.locator("#board").bounding_box()
    turn.click()
    x, y = (float(page.locator(f"#shift-{axis}").input_value()) for axis in "xy")
    middle = spot(page, x, y)
    page.mouse.move(middle[0] + 80, middle[1])
    page.mouse.down()
    page.mouse.move(middle[0] + 40, middle[1] - 60, steps=4)
    page.mouse.move(middle[0], middle[1] - 80, steps=4)
    page.mouse.up()
    assert float(page.locator("#turn").input_value()) == pytest.approx(90, abs=1)
    page.get_by_role("button", name="Move").click()
    world = drawn_middle(page)
    target = EXPECTED @ [*world, 1]
    x, y = (float(page.locator(f"#shift-{axis}").input_value()) for axis in "xy")
    start, end = spot(page, x, y), spot(page, *target)
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=5)
    page.mouse.up()
    keep_picture(page, tmp_path, "align")
    page.get_by_role("button", name="Save alignment").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The alignment is stored.")
    found = plan_from_world(server)
    angle = np.degrees(np.arctan2(found[1, 0], found[0, 0]))
    assert abs(angle - 90) < 1
    corners = np.array([[0, 0, 1], [4, 0, 1], [4, 3, 1], [0, 3, 1]]).T
    assert np.linalg.norm(found @ corners - EXPECTED @ corners, axis=0).mean() < 0.15

    # Pairs: each scan point where it is drawn now, each plan point where it belongs; one is wrong.
    page.get_by_role("button", name="Add a pair").click()
    before = found
    wrong = (0.8, 0.5)
    for world_point in ([0.5, 0.5, 1], [3.5, 0.5, 1], [3.5, 2.5, 1], [0.5, 2.5, 1], [2.0, 1.5, 1]):
        click(page, *(before @ world_point))
        truth = EXPECTED @ world_point
        click(page, *(truth + wrong if world_point[:2] == [2.0, 1.5] else truth))
    pairs = page.locator("#pairs li")
    playwright.expect(pairs).to_have_count(5)
    playwright.expect(pairs.nth(4)).to_contain_text("contradicts the others")
    page.get_by_role("button", name="Remove pair 5").click()
    page.get_by_role("button", name="Fit to the pairs").click()
    fitted = page.locator("#turn").input_value()
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Redo").click()
    # What is not saved comes back.
    page.reload()
    playwright.expect(page.locator("#board-error")).to_contain_text(
        "The alignment that you didn't save is back"
    )
    playwright.expect(page.locator("#turn")).to_have_value(fitted)
    playwright.expect(pairs).to_have_count(4)
    page.get_by_role("button", name="Save alignment").click()
    playwright.expect(page.locator("#board-error")).to_contain_text("The pairs are")
    found = plan_from_world(server)
    assert np.linalg.norm(found @ corners - EXPECTED @ corners, axis=0).max() < 0.03
    assert box is not None


def drawn_middle(page: Any) -> np.ndarray:
    """Return the world point that the middle of the scan's picture shows."""
    return np.array(
        page.evaluate(
            """async () => {
                const { ScanPoints } = await import("/assets/js/studio/scan-image.js");
                const { z_min, z_max } = { z_min: Number(document.getElementById("z-min").value),
                                           z_max: Number(document.getElementById("z-max").value) };
                const i = await (await ScanPoints.of(1)).drawn(z_min, z_max);
                return [i.x + i.width * i.metresPerPx / 2, i.y - i.height * i.metresPerPx / 2];
            }"""
        )
    )


def draw(server: Server, page: Any, tmp_path: Path) -> None:
    """Draw an area, two landmarks and a link; undo, redo, reload, save; try the route."""
    visit(page, "Draw")
    page.get_by_role("button", name="Landmark", exact=True).click()
    for x, y, name in ((1.5, 1.5, "Door"), (3.5, 4.0, "Window")):
        click(page, x, y)
        page.locator("#feature-name").fill(name)
        page.keyboard.press("Enter")
    page.get_by_role("button", name="Link", exact=True).click()
    # Close to the landmarks: the ends snap to them.
    click(page, 1.53, 1.52)
    click(page, 2.5, 3.0)
    click(page, 3.48, 4.03)
    page.get_by_role("button", name="Finish").click()
    page.get_by_role("button", name="Area", exact=True).click()
    for x, y in ((1.1, 1.1), (3.9, 1.1), (3.9, 4.8), (1.1, 4.8)):
        click(page, x, y)
    page.get_by_role("button", name="Finish").click()
    page.locator("#feature-name").fill("Hall")
    page.keyboard.press("Enter")
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Undo").click()
    playwright.expect(page.locator("#feature-list li")).to_have_count(3)
    page.get_by_role("button", name="Redo").click()
    page.get_by_role("button", name="Redo").click()
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    page.reload()
    playwright.expect(page.locator("#board-error")).to_contain_text("What you drew and didn't save is back")
    playwright.expect(page.locator("#feature-list li")).to_have_count(4)
    keep_picture(page, tmp_path, "draw")
    page.get_by_role("button", name="Save", exact=True).click()
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    features = server.client.get("/venues/house/floors/0/features").json()["features"]
    kinds = sorted(each["properties"]["kind"] for each in features)
    assert kinds == ["area", "landmark", "landmark", "link"]
    ends = next(e for e in features if e["properties"]["kind"] == "link")["geometry"]["coordinates"]
    points = [e["geometry"]["coordinates"] for e in features if e["properties"]["kind"] == "landmark"]
    assert [ends[0], ends[-1]] == points
    assert {each["properties"].get("name") for each in features} >= {"Door", "Window", "Hall"}

    page.get_by_role("button", name="Try a route").click()
    click(page, 1.5, 1.5)
    click(page, 3.5, 4.0)
    playwright.expect(page.locator("#draw-words")).to_contain_text("Window. You have arrived.")
    playwright.expect(page.locator("polyline.route")).to_have_count(1)


def try_a_photo(page: Any, room: scenes.Room, tmp_path: Path) -> None:
    """Locate a photo; the matches are drawn."""
    visit(page, "Try")
    pose = scenes.query_poses()[1]
    photo = {"name": "photo.jpg", "mimeType": "image/jpeg", "buffer": room.view(pose).jpeg()}
    page.locator("#photo").set_input_files(photo)
    page.locator("#photo-camera").fill(scenes.CAMERA_TEXT)
    page.get_by_role("button", name="Locate").click()
    result = page.locator("#try-result")
    playwright.expect(result).to_contain_text("Located")
    x, y = EXPECTED @ [*pose.translation[:2], 1]
    shown = re.search(r"At (-?[\d.]+), (-?[\d.]+) m", result.text_content() or "")
    assert shown
    assert np.hypot(float(shown[1]) - x, float(shown[2]) - y) < 0.1
    playwright.expect(page.locator("line.match").nth(10)).to_be_attached()
    keep_picture(page, tmp_path, "try")


def test_the_plan_works_by_keyboard_alone(server: Server, studio: Tab) -> None:
    page = studio.page
    visit(page, "Draw")
    playwright.expect(page.locator("#board-svg image")).to_have_count(1)
    before = len(server.client.get("/venues/house/floors/0/features").json()["features"])
    playwright.expect(page.locator("#board")).to_contain_text("Hall")
    page.get_by_role("button", name="Landmark", exact=True).focus()
    page.keyboard.press("Enter")
    board = page.locator("#board")
    for _ in range(40):
        page.keyboard.press("Tab")
        if board.evaluate("(node) => node === document.activeElement"):
            break
    playwright.expect(board).to_be_focused()
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    playwright.expect(page.locator("#feature-name")).to_be_focused()
    page.keyboard.type("Bench")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Save", exact=True).focus()
    page.keyboard.press("Enter")
    playwright.expect(page.locator("#board-error")).to_contain_text("Saved.")
    features = server.client.get("/venues/house/floors/0/features").json()["features"]
    assert len(features) == before + 1
    assert features[-1]["properties"]["name"] == "Bench"


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
