"""What is wrong after a kill: acknowledged changes that are lost, builds that were not done once, wrong answers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np

from app.errors import RoomfixError
from bench.kills.clients import HEADING_STEP_DEG, VENUE, Acknowledged, Sent

ENDED = ("succeeded", "failed", "cancelled")
WAIT_S = 180.0
POLL_S = 0.1
# From where the first map located the picture.
MAX_MOVE_M = 0.05


@dataclass(slots=True)
class Place:
    """Where the picture was located first; None before."""

    position: list[float] | None = None


def check(client: httpx.Client, kept: Acknowledged, sent: Sent, place: Place) -> list[str]:
    """Return what is wrong now, in words."""
    found = [*_builds(client, kept), *_edits(client, kept), *_sessions(client, kept), *_anchors(client, kept)]
    versions = [item["version"] for item in client.get(f"/venues/{VENUE}/maps").json()]
    if versions != list(range(len(versions), 0, -1)):
        found.append(f"the versions of the map are {versions}")
    if versions:
        found += _answer(client, sent, place, versions[0])
    return found


def _builds(client: httpx.Client, kept: Acknowledged) -> list[str]:
    # What was queued without being acknowledged is built too.
    builds = _wait_for(lambda: _all_ended(client))
    by_id = {each["build"]: each for each in builds}
    found = [f"build {build} is gone" for build in sorted(kept.builds - set(by_id))]
    ended = [by_id[build] for build in sorted(kept.builds & set(by_id))]
    done = [each for each in ended if each["state"] == "succeeded"]
    # Three deaths of its worker end a build; every other one is to succeed.
    found += [
        f"build {each['build']} {each['state']}: {each['error']}"
        for each in ended
        if each not in done and each["error_code"] != "worker_died"
    ]
    if len({each["map_version"] for each in done}) != len(done):
        found.append("two builds made one version of the map")
    return found


def _all_ended(client: httpx.Client) -> list[Any] | None:
    builds = pages(client, "/database/builds")
    return builds if all(each["state"] in ENDED for each in builds) else None


def _edits(client: httpx.Client, kept: Acknowledged) -> list[str]:
    names = {venue["id"]: venue["name"] for venue in pages(client, "/venues")}
    return [
        f"venue {venue} is {names.get(venue)!r}, not {name!r}"
        for venue, name in kept.names.items()
        if names.get(venue) != name
    ]


def _sessions(client: httpx.Client, kept: Acknowledged) -> list[str]:
    found = []
    for session, frames in kept.sessions.items():
        answer = client.get(f"/sessions/{session}", params={"points": 0})
        if answer.status_code != 200 or answer.json()["frames"] < frames:
            found.append(f"session {session} has lost frames: {answer.text[:100]}")
    return found


def _anchors(client: httpx.Client, kept: Acknowledged) -> list[str]:
    anchors = {anchor["id"]: anchor for anchor in pages(client, "/anchors")}
    found = []
    for anchor, heading_deg in kept.headings_deg.items():
        # A change that was sent and not acknowledged may be there or not.
        if anchors.get(anchor, {}).get("heading_deg") not in (heading_deg, heading_deg + HEADING_STEP_DEG):
            found.append(f"anchor {anchor} has lost its change")
    for anchor, received_at in kept.frames.items():
        frame = anchors.get(anchor, {}).get("frame")
        if frame is None or frame["received_at"] < received_at:
            found.append(f"anchor {anchor} has lost its frame")
    return found


def _answer(client: httpx.Client, sent: Sent, place: Place, newest: int) -> list[str]:
    answer = client.post(
        "/locate",
        data={"venue": VENUE, "camera": sent.camera},
        files={"image": ("a.jpg", sent.picture)},
    )
    body = answer.json()
    if answer.status_code != 200 or not body["located"]:
        return [f"the picture is not located: {answer.text[:100]}"]
    position = [body["pose"]["position"][axis] for axis in "xyz"]
    if place.position is None:
        place.position = position
    found = []
    if body["map_version"] != newest:
        found.append(f"version {body['map_version']} serves, not {newest}")
    if np.linalg.norm(np.subtract(position, place.position)) > MAX_MOVE_M:
        found.append(f"the picture is at {position}, not at {place.position}")
    return found


def pages(client: httpx.Client, path: str) -> list[Any]:
    """Return a whole list, page by page."""
    found: list[Any] = []
    where: str | None = path
    while where is not None:
        answer = client.get(where)
        answer.raise_for_status()
        found += answer.json()
        where = answer.links.get("next", {}).get("url")
    return found


def _wait_for(condition: Callable[[], list[Any] | None]) -> list[Any]:
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        value = condition()
        if value is not None:
            return value
        time.sleep(POLL_S)
    raise RoomfixError(f"After {WAIT_S:g} s there is still a build that has not ended.")
