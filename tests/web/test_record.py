"""A scan is recorded on a phone's page, whose camera is a file, and becomes a map that locates."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.geometry.alignment import align_points
from app.geometry.se3 import Pose
from tests import scenes
from tests.server import wait_for
from tests.web.camera_file import CUT_ERRORS, flags_for, write_walk
from tests.web.held import held_back
from tests.web.live import Server, Tab, chromium, live_server, watched_tab
from tests.web.pictures import keep_picture

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("pycolmap", reason="the extra sfm is not installed")
FPS = 10
MARKER_M = 0.4
# Texels from the left and from the floor, on the wall that is filmed.
MARKER_AT = (250, 150)
BORDER = 12
PHONE = {"viewport": {"width": 390, "height": 780}, "locale": "en-US"}


def pose(step: float) -> Pose:
    """Where the phone is on its walk along the wall, which takes 70 steps."""
    height_m = 1.4 + 0.03 * np.sin(step / 6)
    return scenes.pose_at(
        0.9 + 0.023 * step, 0.7 + 0.006 * step, height_m, 62 + 0.56 * step, -22 + 2 * np.sin(step / 5)
    )


def filmed_room() -> scenes.Room:
    room = scenes.Room(seed=4)
    side = int(MARKER_M * scenes.TEXELS_PER_M)
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 0, side)
    wall, (left, bottom) = room._prints[1, 1], MARKER_AT
    wall[bottom - BORDER : bottom + side + BORDER, left - BORDER : left + side + BORDER] = 255
    # Rows of a wall go upwards.
    wall[bottom : bottom + side, left : left + side] = marker[::-1, :, None]
    return room


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with a venue that has nothing."""
    with live_server(tmp_path_factory.mktemp("record")) as server:
        server.client.post("/venues", json={"id": "room", "name": "The room"}).raise_for_status()
        yield server


@pytest.fixture(scope="module")
def camera_browser(driver: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser whose camera shows the walk along the wall, there and back."""
    room = filmed_room()
    pictures = [room.view(pose(step)).rgb for step in range(70)]
    path = tmp_path_factory.mktemp("camera") / "walk.y4m"
    write_walk(path, (*pictures, *pictures[::-1]), scenes.CAMERA.width, scenes.CAMERA.height, FPS)
    with chromium(driver, *flags_for(path)) as browser:
        yield browser


@pytest.fixture
def phone(camera_browser: Any) -> Iterator[Tab]:
    with watched_tab(camera_browser, CUT_ERRORS, **PHONE) as tab:
        yield tab


def open_page(server: Server, tab: Tab) -> None:
    answer = server.client.post("/tokens", json={"venue": "room", "scope": "record"})
    tab.open(f"{server.url}/record/room#token={answer.json()['token']}")
    playwright.expect(tab.page.get_by_role("heading")).to_have_text("Record a scan of The room")


def kept(page: Any) -> int:
    found = re.search(r"(\d+) pictures, (\d+) sent", page.locator("#counts").text_content())
    return int(found[1]) if found else 0


def film(page: Any, count: int) -> None:
    """Film until a number of frames are kept."""
    page.get_by_role("button", name=re.compile("Start filming|Go on filming|Film more")).click()
    wait_for(lambda: page.wait_for_timeout(100) or kept(page) >= count)


def test_a_recording_becomes_a_map_that_locates_although_the_server_restarts(
    server: Server, phone: Tab, tmp_path: Path
) -> None:
    page = phone.page
    open_page(server, phone)
    film(page, 8)
    server.stop()
    playwright.expect(page.locator("#say-more")).to_contain_text("The connection is lost")
    keep_picture(page, tmp_path, "record-cut")
    server.start()
    wait_for(lambda: page.wait_for_timeout(100) or kept(page) >= 36)
    playwright.expect(page.locator("#say-more")).not_to_contain_text("lost")
    keep_picture(page, tmp_path, "record-filming")
    page.get_by_role("button", name="Stop filming").click()
    playwright.expect(page.locator("#say-words")).to_have_text("How large is the place?")
    page.get_by_label("Side of the marker's black square (m)").fill(str(MARKER_M))
    keep_picture(page, tmp_path, "record-size")
    page.get_by_role("button", name="Build the map").click()
    playwright.expect(page.locator("#say-words")).to_have_text("The map is ready")
    keep_picture(page, tmp_path, "record-ready")

    room = filmed_room()
    truths = [pose(step + 0.5) for step in np.linspace(2, 66, 20)]
    found = []
    for truth in truths:
        answer = server.client.post(
            "/locate", data={"venue": "room"}, files={"image": room.view(truth).png()}, timeout=60
        ).json()
        found.append(None if answer["pose"] is None else [answer["pose"]["position"][axis] for axis in "xyz"])
    # The map has a frame of its own: it is laid over the room by every other picture, without a change of scale.
    there = [(truth.translation, at) for truth, at in zip(truths, found, strict=True) if at is not None]
    true_from_map = align_points(
        [at for _, at in there[::2]], [truth for truth, _ in there[::2]], with_scale=False
    )
    errors = [
        np.linalg.norm(true_from_map.target_from_source.apply(np.array([at]))[0] - truth)
        for truth, at in there[1::2]
    ]
    within = sum(error < 0.25 for error in errors)
    (tmp_path / "errors.txt").write_text(f"{len(there)} of {len(truths)} located, errors {np.sort(errors)}")
    assert len(there) >= 0.9 * len(truths)
    assert within >= 0.9 * len(errors)

    page.get_by_role("link", name="Show me where I am").click()
    playwright.expect(page.get_by_role("heading")).to_have_text("The room")


def test_a_page_that_was_closed_goes_on_and_loses_nothing(
    server: Server, camera_browser: Any, tmp_path: Path
) -> None:
    with watched_tab(camera_browser, CUT_ERRORS, **PHONE) as tab:
        page = tab.page
        open_page(server, tab)
        # Nothing can be sent: all frames stay on the phone.
        page.route("**/recordings/*/frames/**", lambda route: route.abort())
        film(page, 6)
        held = kept(page)
        page.unroute("**/recordings/*/frames/**")
        with held_back(page, "**/recordings/*") as state:
            page.reload()
            state.wait()
            # To film before it is known what became of the recording would begin another one.
            playwright.expect(page.get_by_role("button", name="Start filming")).to_be_disabled()
        playwright.expect(page.locator("#say-words")).to_contain_text("was interrupted")
        keep_picture(page, tmp_path, "record-interrupted")
        recording = page.evaluate(
            "() => JSON.parse(localStorage.getItem('roomfix.recording.room')).recording"
        )

        def stored() -> int:
            return int(server.client.get(f"/recordings/{recording}").json()["frames"])

        wait_for(lambda: page.wait_for_timeout(100) or stored() >= held)
        film(page, stored() + 2)
        page.get_by_role("button", name="Stop filming").click()
        address = f"/recordings/{recording}"
        wait_for(lambda: page.wait_for_timeout(100) or server.client.get(address).json()["missing"] == [])
        page.reload()
        page.get_by_role("button", name="Delete it").click()
        playwright.expect(page.get_by_role("button", name="Start filming")).to_be_visible()
        assert server.client.get(f"/recordings/{recording}").status_code == 404
        tab.complaints[:] = [each for each in tab.complaints if "ERR_FAILED" not in each]


def test_a_token_for_visitors_records_nothing(server: Server, phone: Tab) -> None:
    token = server.client.post("/tokens", json={"venue": "room"}).json()["token"]
    phone.open(f"{server.url}/record/room#token={token}")
    phone.page.get_by_role("button", name="Start filming").click()
    playwright.expect(phone.page.locator("#start-error")).to_contain_text("This link may not record")
    phone.complaints[:] = [each for each in phone.complaints if "403" not in each]


def test_a_distance_is_marked_in_a_picture_by_keyboard(server: Server, phone: Tab, tmp_path: Path) -> None:
    page = phone.page
    open_page(server, phone)
    film(page, 13)
    page.get_by_role("button", name="Stop filming").click()
    page.get_by_label("I know a distance in one of the pictures").check()
    page.get_by_role("button", name="Build the map").click()
    playwright.expect(page.locator("#size-error")).to_contain_text("Mark the two ends")
    page.get_by_role("button", name="Later picture").click()
    playwright.expect(page.locator("#shot-title")).to_have_text("Picture 2 of the recording")
    shot = page.locator("#shot")
    shot.focus()
    page.keyboard.press("Enter")
    for _ in range(9):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Enter")
    playwright.expect(page.locator("#points-words")).to_contain_text("Both ends are marked")
    page.get_by_label("Distance between the two points (m)").fill("1.2")
    keep_picture(page, tmp_path, "record-distance")
    with page.expect_request("**/finish") as asked:
        page.get_by_role("button", name="Build the map").click()
    scale = asked.value.post_data_json["scale"]
    assert scale["distance_m"] == 1.2
    assert scale["frame"] == "000001.jpg"
    (u0, v0), (u1, v1) = scale["pixels"]
    assert (u0, v0, v1) == (160, 120, 120)
    assert u1 == pytest.approx(160 + 9 * 10 * 320 / 200, abs=0.2)
