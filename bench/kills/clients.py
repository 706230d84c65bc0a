"""Clients that build, edit, push frames of anchors and walk sessions until their server is gone, and what was stored.

What the servers have acknowledged is kept to be compared.
"""

from __future__ import annotations

import itertools
import threading
from contextlib import suppress
from dataclasses import dataclass, field

import httpx

VENUE = "kills"
FLOOR = {"name": "Ground", "level": 0, "z_min_m": -10, "z_max_m": 10}
TIMEOUT_S = 180.0
FRAMES_PER_SESSION = 2
# Names of venues and anchors that one client changes in turn.
VENUES = 5
ANCHORS = 2
CLIENTS_PER_ANCHOR = 10
HEADING_STEP_DEG = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """What the clients send. `camera` is fx,fy,cx,cy of the picture."""

    scan: bytes
    options: str
    picture: bytes
    camera: str


@dataclass(slots=True, kw_only=True)
class Acknowledged:
    """What the servers have said is stored: builds, names of venues, frames that were answered by session, headings and
    times of the newest frame by anchor. `changes` counts all acknowledged changes."""

    builds: set[str] = field(default_factory=set)
    names: dict[str, str] = field(default_factory=dict)
    sessions: dict[str, int] = field(default_factory=dict)
    headings_deg: dict[str, float] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)
    changes: int = 0


class Client(threading.Thread):
    """Calls until a call fails for want of a server, or it is over."""

    def __init__(
        self, url: str, kept: Acknowledged, sent: Sent, number: int, is_over: threading.Event
    ) -> None:
        super().__init__(daemon=True)
        self._url, self._kept, self._sent, self._number = url, kept, sent, number
        self._is_over = is_over

    def run(self) -> None:
        """Queue a build, then change this and that."""
        with (
            suppress(httpx.TransportError),
            httpx.Client(base_url=self._url, timeout=TIMEOUT_S, trust_env=False) as client,
        ):
            self._build(client)
            for turn in itertools.count():
                if self._is_over.is_set():
                    return
                self._edit(client, f"s{self._number}-{turn % VENUES}", f"name {turn}")
                self._change_anchor(client, f"a{self._number % CLIENTS_PER_ANCHOR}-{turn % ANCHORS}")
                self._walk(client)

    def _build(self, client: httpx.Client) -> None:
        form = {"venue": VENUE, "options": self._sent.options}
        answer = client.post("/database/build", data=form, files={"archive": ("scan.zip", self._sent.scan)})
        if answer.status_code == 202:
            self._kept.builds.add(answer.json()["build"])
            self._kept.changes += 1

    def _edit(self, client: httpx.Client, venue: str, name: str) -> None:
        # A name that was sent and not acknowledged may be there or not.
        before = self._kept.names.pop(venue, None)
        if before is None:
            answer = client.post("/venues", json={"id": venue, "name": name})
        else:
            answer = client.patch(f"/venues/{venue}", json={"name": name})
        if answer.is_success:
            self._kept.names[venue] = name
            self._kept.changes += 1

    def _change_anchor(self, client: httpx.Client, anchor: str) -> None:
        heading_deg = self._kept.headings_deg.get(anchor, 0.0) + HEADING_STEP_DEG
        answer = client.put(f"/anchors/{anchor}", json=_anchor(self._sent.camera, heading_deg))
        if answer.is_success:
            self._kept.headings_deg[anchor] = heading_deg
            self._kept.changes += 1
        answer = client.post(f"/anchors/{anchor}/frames", files={"image": self._sent.picture})
        if answer.is_success:
            self._kept.frames[anchor] = answer.json()["received_at"]
            self._kept.changes += 1

    def _walk(self, client: httpx.Client) -> None:
        answer = client.post("/sessions", json={"venue": VENUE, "camera": self._sent.camera})
        if not answer.is_success:
            return
        session = answer.json()["session"]
        self._kept.sessions[session] = 0
        self._kept.changes += 1
        for _ in range(FRAMES_PER_SESSION):
            answer = client.post(f"/sessions/{session}/frames", files={"image": self._sent.picture})
            if answer.is_success:
                self._kept.sessions[session] = answer.json()["frame"]
                self._kept.changes += 1


def _anchor(camera: str, heading_deg: float) -> dict[str, object]:
    poi = {
        "id": "sign",
        "region_px": [[10, 10], [60, 10], [60, 60], [10, 60]],
        "position": {"x": 3, "y": 1},
        "distance_m": 2.5,
    }
    place = {"venue": VENUE, "floor": "0", "position": {"x": 1, "y": 1}, "height_m": 2}
    return {**place, "camera": camera, "pois": [poi], "heading_deg": heading_deg}
