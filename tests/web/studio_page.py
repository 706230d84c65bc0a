"""The studio in a tab, and clicks on its plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.web.live import KEY, Server, Tab, watched_tab

# The plan image shows 6 m by 5 m.
METERS_PER_PIXEL = 0.01
SIZE_PX = (600, 500)


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
