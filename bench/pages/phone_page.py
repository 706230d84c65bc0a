"""The phone page in Chromium, its camera fed with a rendered walk: how well the dot follows, and how fast."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from app.geometry.plan import plan_position
from bench.demo import VENUE, floor_plans
from bench.pages.browser import browser_page
from bench.recordings.phone_walk import DESTINATION, FPS, PhoneWalk

if TYPE_CHECKING:
    from playwright.sync_api import Page, WebSocket

# Width and height at which a sent picture is compared with the walk's frames.
TINY_PX = (32, 24)
FLAGS = (
    "--use-fake-ui-for-media-stream",
    "--use-fake-device-for-media-stream",
)
# Reads what the page shows: the dot's place, the number of its frame, the state and the words.
READ_PAGE = """() => {
    const you = document.querySelector(".you"), go = document.getElementById("go");
    return { ...you.dataset, stale: you.classList.contains("stale"), state: go.dataset.state ?? "",
             words: document.getElementById("say-words").textContent };
}"""


@dataclass(frozen=True, slots=True)
class Sight:
    """What the page showed at a moment, and the seconds since the camera was asked for."""

    at_s: float
    page: dict[str, Any]


@dataclass(kw_only=True)
class Record:
    """Frames that were sent and answers that came, with their times, and what the page showed."""

    started_s: float = 0.0
    sent: list[tuple[float, bytes]] = field(default_factory=list)
    answers: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    sights: list[Sight] = field(default_factory=list)

    def note_sent(self, payload: str | bytes) -> None:
        """Note a frame."""
        if isinstance(payload, bytes):
            self.sent.append((time.monotonic() - self.started_s, payload))

    def note_received(self, payload: str | bytes) -> None:
        """Note an answer."""
        self.answers.append((time.monotonic() - self.started_s, json.loads(payload)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PhonePageReport:
    """What the page did on a walk.

    Seconds until the first located answer; answers a second; the median time of an answer in the server; the share of
    readings with a fresh dot; errors of the dot in metres, against the frame that it is drawn for and against where the
    walker is when it is read.
    """

    first_answer_s: float
    answers_per_s: float
    answer_ms: float
    located_ratio: float
    frame_errors_m: NDArray[np.float64]
    present_errors_m: NDArray[np.float64]
    arrived: bool
    instructions: tuple[str, ...]


@contextmanager
def phone_page(walk: PhoneWalk) -> Iterator[Page]:
    """Open a browser of a phone's size whose camera shows the walk; yields its page."""
    flags = [*FLAGS, f"--use-file-for-fake-video-capture={walk.video}"]
    with browser_page(*flags, width=390, height=780) as page:
        yield page


def record_walk(page: Page, address: str, walk: PhoneWalk, picture: Path | None = None) -> Record:
    """Open the phone page, ask for the walk's destination, and watch until the walk is over.

    The browser plays the walk from its beginning whenever a page opens the camera.
    """
    record = Record()

    def listen(socket: WebSocket) -> None:
        socket.on("framesent", record.note_sent)
        socket.on("framereceived", record.note_received)

    page.on("websocket", listen)
    page.goto(f"{address}/go/{VENUE.id}")
    page.get_by_role("button", name="Where to?").wait_for(state="hidden")
    page.locator("#plan-svg image").wait_for()
    record.started_s = time.monotonic()
    page.get_by_role("button", name="Show me where I am").click()
    page.get_by_role("button", name="Where to?").click()
    page.get_by_label("Name of a place").fill(DESTINATION)
    page.locator("#places button").first.click()
    while (now := time.monotonic() - record.started_s) < len(walk.frames) / FPS:
        record.sights.append(Sight(now, page.evaluate(READ_PAGE)))
        if picture is not None and now > len(walk.frames) / FPS / 2:
            page.screenshot(path=picture)
            picture = None
        page.wait_for_timeout(50)
    page.remove_listener("websocket", listen)
    page.goto("about:blank")
    return record


def report_of(record: Record, walk: PhoneWalk) -> PhonePageReport:
    """Compare what the page showed with the truth."""
    floors = {floor.level: floor for floor in floor_plans()}
    truth = np.array([plan_position(floors[0].plan_from_world, pose)[:2] for pose in walk.world_from_camera])
    shown = _frames_shown([data for _, data in record.sent], walk.frames)
    # The video began when the camera opened: known by each sent frame, to a frame.
    begun_s = float(np.median([at - frame / FPS for (at, _), frame in zip(record.sent, shown, strict=True)]))
    by_frame, now, fresh = [], [], []
    for sight in record.sights:
        fresh.append("x" in sight.page and not sight.page["stale"])
        if not fresh[-1]:
            continue
        dot = np.array([float(sight.page["x"]), float(sight.page["y"])])
        by_frame.append(np.linalg.norm(dot - truth[shown[int(sight.page["frame"]) - 1]]))
        at = int(np.clip(round((sight.at_s - begun_s) * FPS), 0, len(truth) - 1))
        now.append(np.linalg.norm(dot - truth[at]))
    located = [at for at, body in record.answers if body.get("located")]
    times_ms = [body["timings_ms"]["total"] for _, body in record.answers if "timings_ms" in body]
    words = [sight.page["words"] for sight in record.sights if sight.page["state"] in ("leading", "arrived")]
    return PhonePageReport(
        first_answer_s=located[0] if located else float("inf"),
        answers_per_s=len(record.answers) / max(record.answers[-1][0] - record.answers[0][0], 1e-9),
        answer_ms=float(np.median(times_ms)),
        located_ratio=float(np.mean(fresh)),
        frame_errors_m=np.array(by_frame),
        present_errors_m=np.array(now),
        arrived=any(sight.page["state"] == "arrived" for sight in record.sights),
        instructions=tuple(dict.fromkeys(words)),
    )


def _frames_shown(sent: Sequence[bytes], frames: Sequence[Path]) -> list[int]:
    """Return the number of the walk's frame that each sent picture shows: the one that differs least."""
    known = np.stack([_tiny(path.read_bytes()) for path in frames])
    return [int(np.abs(known - _tiny(data)).mean(axis=(1, 2)).argmin()) for data in sent]


def _tiny(data: bytes) -> NDArray[np.float32]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    return cv2.resize(np.asarray(image), TINY_PX, interpolation=cv2.INTER_AREA).astype(np.float32)
