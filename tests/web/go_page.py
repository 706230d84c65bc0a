"""The phone page in a tab: how it is opened, what goes over its wire, and what its camera sees."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import cv2
import numpy as np

from app.geometry.se3 import Pose
from tests import scenes
from tests.web.live import KEY, Server, Tab

WALK = [scenes.pose_at(1.5 + 0.012 * k, 1.35 + 0.006 * k, 1.52, -30 + 1.3 * k, 0.0) for k in range(70)]


@cache
def pictures() -> list[np.ndarray]:
    """Return what the camera sees on the walk."""
    room = scenes.Room()
    return [room.view(pose).rgb for pose in WALK]


@dataclass
class Wire:
    """What went over the WebSockets of a page."""

    frames: list[bytes] = field(default_factory=list)
    hints: list[dict[str, Any]] = field(default_factory=list)
    answers: list[dict[str, Any]] = field(default_factory=list)
    opened: int = 0

    @staticmethod
    def of(page: Any) -> Wire:
        wire = Wire()

        def listen(socket: Any) -> None:
            wire.opened += 1
            # Answers count the frames of their own connection.
            wire.frames.clear()
            socket.on("framesent", wire.sent)
            socket.on("framereceived", lambda data: wire.answers.append(json.loads(data)))

        page.on("websocket", listen)
        return wire

    def sent(self, data: str | bytes) -> None:
        if isinstance(data, bytes):
            self.frames.append(data)
        else:
            self.hints.append(json.loads(data))


def go(server: Server, tab: Tab, venue: str = "room", *, token: bool = True, query: str = "") -> Wire:
    wire = Wire.of(tab.page)
    tab.open(f"{server.url}/go/{venue}{query}" + (f"#token={KEY}" if token else ""))
    return wire


def begin(page: Any) -> None:
    page.get_by_role("button", name="Show me where I am").click()


def words(page: Any) -> Any:
    return page.locator("#say-words")


def truth_of(frame: bytes) -> Pose:
    """Return the pose of the walk's frame that a sent picture shows: the one whose rendered view differs least."""
    sent = _tiny(cv2.imdecode(np.frombuffer(frame, np.uint8), cv2.IMREAD_COLOR)[..., ::-1])
    return WALK[int(np.argmin([np.abs(sent - each).mean() for each in _tiny_pictures()]))]


@cache
def _tiny_pictures() -> list[np.ndarray]:
    return [_tiny(rgb) for rgb in pictures()]


def _tiny(rgb: np.ndarray) -> np.ndarray:
    return cv2.resize(cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY), (32, 24)).astype(float)


def dot(page: Any) -> dict[str, str]:
    return dict(page.evaluate("() => ({ ...document.querySelector('.you').dataset })"))
