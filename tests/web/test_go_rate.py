"""How many frames the phone page sends: as many as are answered, within its bounds; smaller ones on a slow network."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.server import wait_for
from tests.web.camera_file import CUT_ERRORS, flags_for, write_walk
from tests.web.go_page import Wire, begin, go
from tests.web.held import HeldAnswers
from tests.web.live import Server, Tab, chromium, live_server, watched_tab

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
SIZE_PX = (640, 480)
# As in stream.js.
MAX_UNANSWERED, MAX_FPS = 2, 10
# Of the widths of its pictures, in its order.
WIDTHS = (640, 480, 320)
# The camera's time that passes while it is made sure that nothing is sent.
QUIET_S = 1.0


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server whose venue has no map: its answers take hardly any time."""
    with live_server(tmp_path_factory.mktemp("rate")) as server:
        server.client.post("/venues", json={"id": "room", "name": "The room"}).raise_for_status()
        yield server


@pytest.fixture(scope="module")
def camera_browser(driver: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser whose camera has pictures as large as the page sends."""
    noise = np.random.default_rng(0).integers(0, 256, (12, SIZE_PX[1] // 8, SIZE_PX[0] // 8, 3), np.uint8)
    path = tmp_path_factory.mktemp("camera") / "noise.y4m"
    film = [np.asarray(cv2.resize(each, SIZE_PX), np.uint8) for each in noise]
    with chromium(driver, *flags_for(write_walk(path, film, *SIZE_PX, 30))) as browser:
        yield browser


@pytest.fixture
def phone(camera_browser: Any) -> Iterator[Tab]:
    """A tab as wide as a phone."""
    size = {"width": 390, "height": 780}
    with watched_tab(camera_browser, CUT_ERRORS, viewport=size, locale="en-US") as tab:
        yield tab


def let_film_run(page: Any) -> None:
    """Wait until the camera has shown more of its film."""
    now = "() => document.getElementById('camera').currentTime"
    start = page.evaluate(now)
    wait_for(lambda: page.wait_for_timeout(30) or page.evaluate(now) > start + QUIET_S)


def test_as_many_frames_are_sent_as_are_answered_and_no_queue_grows(server: Server, phone: Tab) -> None:
    page = phone.page
    answers = HeldAnswers.of(page)
    go(server, phone)
    begin(page)
    # Without an answer there are two: one that the server works on, one that is on its way.
    answers.wait_until(lambda: len(answers.frames) == MAX_UNANSWERED)
    let_film_run(page)
    assert len(answers.frames) == MAX_UNANSWERED
    # Slow answers: each lets one more frame go.
    for number in range(1, 6):
        answers.release()
        answers.wait_until(lambda: answers.unanswered == MAX_UNANSWERED)
        let_film_run(page)
        assert len(answers.frames) == MAX_UNANSWERED + number
    # Fast answers: frames go by themselves, but no more than ten a second.
    slow = len(answers.frames)
    answers.let_through()
    answers.wait_until(lambda: len(answers.frames) >= slow + 30)
    taken_s = [hint["timestamp"] for hint in answers.hints[slow + MAX_UNANSWERED :]]
    assert min(later - earlier for earlier, later in pairwise(taken_s)) > 0.98 / MAX_FPS
    # Slow again.
    answers.hold()
    answers.wait_until(lambda: answers.unanswered == MAX_UNANSWERED)
    sent = len(answers.frames)
    let_film_run(page)
    assert len(answers.frames) == sent
    assert answers.most_unanswered == MAX_UNANSWERED


def test_the_answer_that_is_shown_is_of_a_recent_frame_however_slow_the_server_is(
    server: Server, phone: Tab
) -> None:
    page = phone.page
    answers = HeldAnswers.of(page)
    go(server, phone)
    begin(page)
    for _ in range(4):
        answers.wait_until(lambda: answers.unanswered == MAX_UNANSWERED)
        let_film_run(page)
        answers.release()
    answers.wait_until(lambda: answers.unanswered == MAX_UNANSWERED)
    # A frame that is sent when an answer comes is taken then, not earlier: it waits nowhere.
    taken_s = [hint["timestamp"] for hint in answers.hints]
    for earlier, later in pairwise(taken_s[1:]):
        assert later - earlier > 0.9 * QUIET_S


def test_frames_get_smaller_while_they_wait_to_be_sent_and_larger_again(server: Server, phone: Tab) -> None:
    page = phone.page
    # What waits in the browser, as on a slow network.
    page.add_init_script(
        "globalThis.waiting = 0;"
        "Object.defineProperty(WebSocket.prototype, 'bufferedAmount', { get: () => globalThis.waiting });"
    )
    wire = Wire.of(page)
    widths: list[int] = []

    def note(socket: Any) -> None:
        socket.on(
            "framesent", lambda data: widths.append(width_of(data)) if isinstance(data, bytes) else None
        )

    page.on("websocket", note)
    go(server, phone)
    begin(page)
    wait_for(lambda: page.wait_for_timeout(30) or len(widths) > 2)
    assert set(widths) == {WIDTHS[0]}
    page.evaluate("() => { globalThis.waiting = 1_000_000; }")
    let_film_run(page)
    sent = len(widths)
    let_film_run(page)
    # Nothing is added to what waits.
    assert len(widths) == sent
    page.evaluate("() => { globalThis.waiting = 0; }")
    wait_for(lambda: page.wait_for_timeout(30) or (len(widths) > sent + 1 and widths[-1] == WIDTHS[0]))
    assert [width for width, after in pairwise([*widths[sent:], 0]) if width != after] == [320, 480, 640]
    assert wire.opened == 1


def test_an_accuracy_is_never_said_to_be_nothing(server: Server, phone: Tab) -> None:
    go(server, phone, query="?language=de")
    playwright.expect(phone.page.locator("#start-camera")).to_have_text("Zeig mir, wo ich bin")
    said = phone.page.evaluate(
        """async () => {
            const { accuracyWords } = await import("/assets/js/go/guide.js");
            return [0, 0.004, 0.03, 1.257].map(accuracyWords);
        }"""
    )
    assert said == ["0,01", "0,01", "0,03", "1,26"]


def width_of(jpeg: bytes) -> int:
    return int(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape[1])


def test_the_bounds_are_those_of_the_page() -> None:
    source = (Path(__file__).parents[2] / "app/web/static/js/go/stream.js").read_text(encoding="utf-8")
    assert re.search(rf"MAX_UNANSWERED = {MAX_UNANSWERED};", source)
    assert re.search(rf"MAX_FPS = {MAX_FPS};", source)
