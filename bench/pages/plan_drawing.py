"""A plan with areas, names, a moving dot and its trail: drawn by the pages' own modules, and by MapLibre."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware.gzip import GZipMiddleware
from starlette.responses import Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.web.pages import PAGE_HEADERS, STATIC, WithHeaders
from bench.demo import floor_plans
from bench.recordings.phone_walk import walk_poses

if TYPE_CHECKING:
    from playwright.sync_api import Page

PAGES = Path(__file__).parent / "drawing"
# What the browser counts of its main thread, seconds.
COUNTED = ("ScriptDuration", "TaskDuration")
DRAWN = ("/plan.json", "/features.json", "/plan.png")


@dataclass(kw_only=True)
class Load:
    """One load of a page.

    Milliseconds until the plan was drawn; milliseconds of script, and of all work of the main thread, for each move of
    the dot and each frame of a pan; frames a second while panning; and what the browser complained of.
    """

    drawn_ms: float = 0.0
    move_script_ms: float = 0.0
    move_task_ms: float = 0.0
    pan_script_ms: float = 0.0
    pan_task_ms: float = 0.0
    pan_frames_s: float = 0.0
    complaints: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Served:
    """The address of the pages, and the bytes sent of each file but the plan's picture and features."""

    address: str
    sizes: dict[str, int]


class Counted:
    """Counts the bytes of the bodies that an ASGI app sends, by path: those that workers of a page ask for, too."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.sizes: dict[str, int] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        path = scope["path"]

        async def count(message: Message) -> None:
            if path not in DRAWN:
                self.sizes[path] = self.sizes.get(path, 0) + len(message.get("body", b""))
            await send(message)

        return await self._app(scope, receive, count)


@contextmanager
def drawings_served(maplibre: Path | None) -> Iterator[Served]:
    """Serve both pages and what they draw, with the headers and the compression of the product."""
    counted = Counted(_app(maplibre))
    server = uvicorn.Server(uvicorn.Config(counted, port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        while not server.started:
            thread.join(0.05)
        port = server.servers[0].sockets[0].getsockname()[1]
        yield Served(f"http://127.0.0.1:{port}", counted.sizes)
    finally:
        server.should_exit = True
        thread.join()


def measure_load(page: Page, url: str, *, slower: float, seconds: float, picture: Path | None = None) -> Load:
    """Open one of the pages, walk and pan; the processor is made `slower` times as slow for it."""
    load = Load()
    client = page.context.new_cdp_session(page)
    client.send("Performance.enable")
    client.send("Emulation.setCPUThrottlingRate", {"rate": slower})
    page.on(
        "console", lambda message: load.complaints.append(message.text) if message.type == "error" else None
    )
    page.on("pageerror", lambda error: load.complaints.append(str(error)))
    page.goto(url)
    page.wait_for_function("() => window.drawing !== undefined", timeout=120_000)
    load.drawn_ms = page.evaluate("() => drawing.drawnMs")
    page.evaluate("() => drawing.closeUp()")
    page.wait_for_load_state("networkidle")
    walked, work = _counted(client, page, f"() => drawing.walk({seconds})")
    load.move_script_ms, load.move_task_ms = (1000 * value / walked["moves"] for value in work)
    if picture is not None:
        page.screenshot(path=picture)
    panned, work = _counted(client, page, f"() => drawing.pan({seconds})")
    load.pan_script_ms, load.pan_task_ms = (1000 * value / panned["frames"] for value in work)
    load.pan_frames_s = panned["frames"] / seconds
    return load


def _counted(client: Any, page: Page, action: str) -> tuple[dict[str, int], list[float]]:
    """Return what an action says, and the seconds that it took of script and of all tasks."""
    before = _metrics(client)
    said = page.evaluate(action)
    after = _metrics(client)
    return said, [after[name] - before[name] for name in COUNTED]


def _metrics(client: Any) -> dict[str, float]:
    return {each["name"]: each["value"] for each in client.send("Performance.getMetrics")["metrics"]}


def _app(maplibre: Path | None) -> WithHeaders:
    floor = floor_plans()[0]
    image = cv2.imdecode(np.frombuffer(floor.plan_png, np.uint8), cv2.IMREAD_COLOR)
    height, width = np.asarray(image).shape[:2]
    walk = floor.plan_from_world @ np.array([[*pose.translation, 1] for pose in walk_poses()]).T
    plan = {"width": width, "height": height, "meters_per_pixel": floor.meters_per_pixel}
    plan |= {"origin_px": list(floor.origin_px), "walk": walk[:2].T.tolist()}
    kept = [each for each in floor.features["features"] if each["properties"]["kind"] in ("area", "landmark")]
    features = {"type": "FeatureCollection", "features": kept}
    routes = [
        Route("/plan.json", lambda _: Response(json.dumps(plan), media_type="application/json")),
        Route("/features.json", lambda _: Response(json.dumps(features), media_type="application/json")),
        Route("/plan.png", lambda _: Response(floor.plan_png, media_type="image/png")),
        Mount("/assets", StaticFiles(directory=STATIC)),
    ]
    if maplibre is not None:
        routes.append(Mount("/maplibre", StaticFiles(directory=maplibre)))
    app = Starlette(routes=[*routes, Mount("/", StaticFiles(directory=PAGES))])
    return WithHeaders(GZipMiddleware(app), PAGE_HEADERS)
