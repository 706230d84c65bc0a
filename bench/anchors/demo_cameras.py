"""The demonstration's three monitoring cameras, in rooms that its scan of one wing leaves out, and phones there."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from pathlib import Path

import httpx

from app.engine.anchors.features import AnchorDescriber
from app.services.anchors import AnchorService
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from bench.anchors.demo_anchors import anchor_pair
from bench.recordings.monitors import MonitorPair, render_monitor_pairs
from bench.render.frames import Progress
from bench.venue.layout import room_by_id

# None of them is in the wing.
CAMERA_ROOMS = ("0-lobby", "1-library", "1-gallery-d")
ANGLES_DEG = (20.0, 35.0)
DISTANCES_M = (2.0, 4.5)
# Well below the age from which a frame is not used any more.
PUSH_EVERY_S = 20.0
TIMEOUT_S = 10.0


def camera_id(number: int) -> str:
    """Return the anchor's id of a camera."""
    return f"demo-{CAMERA_ROOMS[number]}"


def render_cameras(
    directory: Path, *, workers: int = 1, progress: Progress | None = None
) -> list[MonitorPair]:
    """Return the cameras' pictures and a phone's for each, rendered into the directory unless they are there."""
    rooms = [room_by_id(room) for room in CAMERA_ROOMS]
    return render_monitor_pairs(
        directory, len(rooms), ANGLES_DEG, DISTANCES_M, workers=workers, progress=progress, rooms=rooms
    )


def put_cameras(resources: Resources, pairs: Sequence[MonitorPair]) -> None:
    """Make the cameras anchors, and push their first frames."""
    anchors = AnchorService(resources, MapLibrary(resources), AnchorDescriber())
    for number, pair in enumerate(pairs):
        anchors.put(camera_id(number), anchor_pair(pair).spec)
        anchors.push(camera_id(number), pair.monitor.read_bytes())


class FreshFrames:
    """Pushes the cameras' frames to a server again and again, as monitoring cameras do, until it is closed."""

    def __init__(self, server: str, pairs: Sequence[MonitorPair], every_s: float = PUSH_EVERY_S) -> None:
        self._server, self._pairs, self._every_s = server, pairs, every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._push, name="demonstration cameras", daemon=True)

    @property
    def is_running(self) -> bool:
        """Whether frames are being pushed."""
        return self._thread.is_alive()

    def __enter__(self) -> FreshFrames:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _push(self) -> None:
        # A line for each frame would hide what the server logs.
        logging.getLogger("httpx").setLevel(logging.WARNING)
        frames = [pair.monitor.read_bytes() for pair in self._pairs]
        with httpx.Client(base_url=self._server, timeout=TIMEOUT_S) as client:
            while not self._stop.wait(self._every_s):
                for number, frame in enumerate(frames):
                    try:
                        client.post(f"/anchors/{camera_id(number)}/frames", files={"image": ("0.jpg", frame)})
                    except httpx.TransportError:
                        # The server is busy or stops: the next frame comes soon.
                        continue
