"""The studio in a tab, and clicks on its plan."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from PIL import Image

from app.storage.db import Database
from app.storage.sessions import SessionPoint, create_session, record_frame
from tests.web.live import KEY, Server, Tab, watched_tab

# The plan image shows 6 m by 5 m.
METERS_PER_PIXEL = 0.01
SIZE_PX = (600, 500)
# What `open_studio` does as a person would: click the field of the key, type it, and press the button.
OPENING_ACTIONS = 3


@contextmanager
def open_studio(browser: Any, server: Server) -> Iterator[Tab]:
    """Open the studio with the key; refused requests that a test makes on purpose are noted by the browser."""
    with watched_tab(browser, ("401", "422", "409"), locale="en-US") as tab:
        tab.page.on("dialog", lambda dialog: dialog.accept())
        tab.open(f"{server.url}/studio")
        tab.page.get_by_label("Key", exact=True).fill(KEY)
        tab.page.get_by_role("button", name="Use this key").click()
        tab.page.get_by_role("dialog").first.wait_for(state="hidden")
        yield tab


def visit(page: Any, name: str) -> None:
    """Go to a view by its link."""
    # The list of steps on the first view has links of the same names, once it is loaded.
    page.get_by_role("navigation", name="Steps").get_by_role("link", name=name, exact=True).click()


def spot(page: Any, x: float, y: float) -> tuple[float, float]:
    """Return the point of the screen that shows a point of the plan, whose frame is that of the stored plan."""
    u, v = x / METERS_PER_PIXEL, SIZE_PX[1] - 1 - y / METERS_PER_PIXEL
    at = page.evaluate(
        """([u, v]) => { const p = new DOMPoint(u, v).matrixTransform(
            document.getElementById("board-svg").getScreenCTM()); return [p.x, p.y]; }""",
        [u, v],
    )
    return float(at[0]), float(at[1])


def click(page: Any, x: float, y: float) -> None:
    """Click a point of the plan."""
    page.mouse.click(*spot(page, x, y))


def mark(target: Any, *shares: tuple[float, float]) -> None:
    """Click points of a picture, each a share of its width and height."""
    target.scroll_into_view_if_needed()
    box = target.bounding_box()
    for across, down in shares:
        target.page.mouse.click(box["x"] + box["width"] * across, box["y"] + box["height"] * down)


def store_walk(database: Database, *, share: bool) -> str:
    """Store a session that was located, lost for three frames, and located again a metre further."""
    with database.write() as connection:
        session = create_session(connection, "house", None, None, None, share=share)
    for frame, x in enumerate((2.0, None, None, None, 3.0), start=1):
        point = SessionPoint(
            frame=frame,
            time_s=float(frame),
            tracking="lost" if x is None else "tracking",
            pose=None,
            floor=None if x is None else "0",
            plan=None if x is None else [x, 2.5, 90.0],
            position_m=None if x is None else 0.1,
        )
        with database.write() as connection:
            record_frame(connection, session, None, {}, point, keep_points=100)
    return session.id


def plan_pdf() -> bytes:
    """Return the plan as the second page of a PDF, of as many pixels as the server draws it with."""
    image = np.full((SIZE_PX[1], SIZE_PX[0], 3), 250, np.uint8)
    # The room's walls: it is 3 m wide and 4 m long.
    left, right, high, low = 100, 400, 50, 450
    image[high:low, left : left + 3] = image[high:low, right : right + 3] = 0
    image[low : low + 3, left:right] = image[high : high + 3, left:right] = 0
    pages = [Image.fromarray(np.full_like(image, 255)), Image.fromarray(image)]
    file = io.BytesIO()
    pages[0].save(file, "pdf", save_all=True, append_images=pages[1:], resolution=150)
    return file.getvalue()
