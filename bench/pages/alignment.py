"""The studio's Align view in Chromium, used by a hand that errs: how well a scan is laid over a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
from numpy.typing import NDArray

from app.errors import RoomfixError

if TYPE_CHECKING:
    from playwright.sync_api import Page

Floats = NDArray[np.float64]

# A hand presses and lets go this far from what it means, in any direction, on a whole pixel of the screen.
HAND_PX = (1.0, 2.0)
# How far from its middle the scan is held to turn it at first, pixels of the screen.
ARM_PX = 100.0
# How far the wheel zooms in for the last touches of dragging, and for the clicks of pairs.
ZOOM = 6.0
PAIR_ZOOMS = (1.0, 6.0, 12.0)
# The viewport zooms by exp(0.0015) for each unit that a wheel is turned.
WHEEL_LOG = 0.0015
# Sizes that a scan has when a hand begins.
START_SCALES = (0.9, 1.1)
READ_MATRICES = """() => {
    const numbers = ({ a, b, c, d, e, f }) => [[a, c, e], [b, d, f]];
    const scan = document.querySelector("#board-svg image.scan");
    return [document.getElementById("board-svg"), scan].map((node) => numbers(node.getScreenCTM()));
}"""
READ_SCAN = """async ([venue, version]) => {
    const { ScanPoints } = await import("/assets/js/studio/scan-image.js");
    const [low, high] = ["z-min", "z-max"].map((id) => Number(document.getElementById(id).value));
    const { x, y, width, height, metresPerPx } = await (await ScanPoints.of(venue, version)).drawn(low, high);
    return [x, y, metresPerPx, width, height];
}"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Where a scan is laid over a plan.

    `truth` (2, 3) is the plan_from_world of x and y. `marks` (n, 2), n >= 4, are world points that a person finds in
    the scan and in the plan, such as corners of rooms: the first near the middle of the scan, the second far from it,
    the third far from the second. `corners` (m, 2) are the world points at which an alignment is judged. `z_max_m`
    leaves ceilings out. When a hand begins the scan is up to `start_shift_m` off in x and in y.
    """

    address: str
    venue: str
    floor: str
    version: int
    truth: Floats
    marks: Floats
    corners: Floats
    z_max_m: float
    start_shift_m: float

    @property
    def path(self) -> str:
        """The floor's path."""
        return f"{self.address}/venues/{self.venue}/floors/{self.floor}"


@dataclass(frozen=True, slots=True)
class Misalignment:
    """How far a stored alignment is off: metres at the worst corner and on average, degrees, size in percent."""

    largest_m: float
    mean_m: float
    turn_deg: float
    size_percent: float


@dataclass(frozen=True, slots=True)
class Hands:
    """What came of one person's work: of dragging alone, and of pairs, by how far was zoomed in for their clicks."""

    dragged: Misalignment
    paired: dict[float, Misalignment]


class AlignPage:
    """The Align view, and a seeded hand at its mouse."""

    def __init__(self, page: Page, site: Site, seed: int, headers: dict[str, str] | None = None) -> None:
        self.page = page
        self.site = site
        self.rng = np.random.default_rng(seed)
        self.client = httpx.Client(headers=headers, timeout=60)
        self.floor: dict[str, Any] = self.client.get(site.path).raise_for_status().json()

    def work(self) -> Hands:
        """Begin far from the truth, drag, then click pairs; each result is what the server has stored."""
        self.store(self._start())
        self._open()
        self.drag_into_place()
        dragged = self._save()
        paired = {}
        for zoom in PAIR_ZOOMS:
            self.store(dragged)
            self._open()
            self.click_pairs(zoom)
            paired[zoom] = misalignment(self._save(), self.site)
        self.client.close()
        return Hands(misalignment(dragged, self.site), paired)

    def store(self, plan_from_world: Floats) -> None:
        """Let the server have an alignment (2, 3)."""
        matrix = np.eye(4)
        matrix[:2, [0, 1, 3]] = plan_from_world
        matrix[2, 2] = math.hypot(*plan_from_world[:, 0])
        kept = {name: self.floor[name] for name in ("name", "level", "z_min_m")}
        body = {**kept, "z_max_m": self.site.z_max_m, "plan_from_world": matrix.tolist()}
        self.client.put(self.site.path, json=body).raise_for_status()

    def drag_into_place(self) -> None:
        """Turn, size and move the scan with the whole plan in view; then again close up."""
        middle, far, opposite = self.site.marks[:3]
        self._turn_parallel(far)
        self._drag("Move", middle)
        self._type_size(self._compared_size(far, opposite))
        self._drag("Move", middle)
        for _ in range(2):
            self._close_up(middle, ZOOM)
            self._drag("Move", middle)
            self._close_up(far, ZOOM)
            self._drag("Turn", far)
            self._type_size(self._size_at(far))
        self._close_up(middle, ZOOM)
        self._drag("Move", middle)

    def click_pairs(self, zoom: float) -> None:
        """Click every mark in the scan and in the plan, and fit to these pairs."""
        self._press("Add a pair")
        for mark in self.site.marks:
            self._close_up(mark, zoom)
            for point in (self._shown(mark), self._wanted(mark)):
                self.page.mouse.click(*self._hand(point))
        self._press("Fit to the pairs")

    def _start(self) -> Floats:
        turn, scale = self.rng.uniform(-math.pi, math.pi), self.rng.uniform(*START_SCALES)
        linear = scale * _rotation(turn)
        middle = self.site.marks[0]
        there = self.site.truth @ [*middle, 1] + self.rng.uniform(-1, 1, 2) * self.site.start_shift_m
        return np.column_stack([linear, there - linear @ middle])

    def _open(self) -> None:
        self.page.goto("about:blank")
        self.page.goto(f"{self.site.address}/studio#align")
        self.page.locator("#board-svg image.scan").wait_for()
        self.scan = self.page.evaluate(READ_SCAN, [self.site.venue, self.site.version])

    def _save(self) -> Floats:
        self._press("Save alignment")
        self.page.get_by_text("The alignment is stored.").wait_for()
        matrix = np.array(self.client.get(self.site.path).raise_for_status().json()["plan_from_world"])
        return matrix[:2, [0, 1, 3]]

    def _press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def _hand(self, point: Floats) -> tuple[float, float]:
        """Return the whole pixel that the hand finds for a point of the screen.

        Raises `RoomfixError` where the plan is not shown: nobody can see or hold anything there.
        """
        angle, length = self.rng.uniform(0, 2 * math.pi), self.rng.uniform(*HAND_PX)
        u, v = np.rint(point + length * np.array([math.cos(angle), math.sin(angle)]))
        box = self.page.locator("#board").bounding_box()
        if box is None or not (0 <= u - box["x"] < box["width"] and 0 <= v - box["y"] < box["height"]):
            raise RoomfixError(f"The hand left the plan: ({u:.0f}, {v:.0f}) is outside {box}.")
        return float(u), float(v)

    def _shown(self, world: Floats) -> Floats:
        """Return where the screen shows a world point of the scan."""
        x, y, metres_per_px = self.scan[:3]
        in_picture = [(world[0] - x) / metres_per_px, (y - world[1]) / metres_per_px, 1]
        return np.asarray(np.array(self.page.evaluate(READ_MATRICES)[1]) @ in_picture)

    def _wanted(self, world: Floats) -> Floats:
        """Return where the screen shows the plan's point of a world point."""
        return self._on_screen(self.site.truth @ [*world, 1])

    def _on_screen(self, plan: Floats) -> Floats:
        meters_per_pixel, (u0, v0) = self.floor["plan"]["meters_per_pixel"], self.floor["plan"]["origin_px"]
        units = [u0 + plan[0] / meters_per_pixel, v0 - plan[1] / meters_per_pixel, 1]
        return np.asarray(np.array(self.page.evaluate(READ_MATRICES)[0]) @ units)

    def _pivot(self) -> Floats:
        """Return the world point about which the page turns and sizes: the middle of the scan's picture."""
        x, y, metres_per_px, width, height = self.scan
        return np.array([x + width * metres_per_px / 2, y - height * metres_per_px / 2])

    def _turn_parallel(self, mark: Floats) -> None:
        """Drag around the middle of the scan until its walls are parallel to those of the plan.

        The scan is held near its middle: what is far from it may not be in view yet.
        """
        pivot = self._shown(self._pivot())
        towards = self._shown(mark) - pivot
        arm = towards * ARM_PX / np.linalg.norm(towards)
        wanted = self._wanted(mark) - self._wanted(self._pivot())
        turned = _rotation(math.atan2(wanted[1], wanted[0]) - math.atan2(arm[1], arm[0])) @ arm
        self._drag_screen("Turn", pivot + arm, pivot + turned)

    def _drag(self, tool: str, mark: Floats) -> None:
        """Drag a mark of the scan to where the plan has it."""
        self._drag_screen(tool, self._shown(mark), self._wanted(mark))

    def _drag_screen(self, tool: str, start: Floats, end: Floats) -> None:
        self._press(tool)
        self.page.mouse.move(*self._hand(start))
        self.page.mouse.down()
        self.page.mouse.move(*self._hand(end), steps=8)
        self.page.mouse.up()

    def _compared_size(self, a: Floats, b: Floats) -> float:
        """Return the size at which two marks are as far from each other as in the plan, as the hand sees it."""
        return (
            self._size()
            * _distance(*map(self._seen, (self._wanted(a), self._wanted(b))))
            / _distance(*map(self._seen, (self._shown(a), self._shown(b))))
        )

    def _size_at(self, mark: Floats) -> float:
        """Return the size at which a mark, dragged there by turning, is as far from the middle as in the plan."""
        pivot = self._shown(self._pivot())
        return (
            self._size()
            * _distance(self._seen(self._wanted(mark)), pivot)
            / _distance(self._seen(self._shown(mark)), pivot)
        )

    def _seen(self, point: Floats) -> Floats:
        return np.array(self._hand(point))

    def _size(self) -> float:
        return float(self.page.locator("#scale").input_value())

    def _type_size(self, size: float) -> None:
        self.page.locator("#scale").fill(f"{size:.3f}")
        self.page.keyboard.press("Tab")

    def _close_up(self, mark: Floats, zoom: float) -> None:
        """Show the whole plan, then turn the wheel over a mark."""
        self.page.locator("#board").focus()
        self.page.keyboard.press("0")
        if zoom == 1:
            return
        before = self.page.evaluate(READ_MATRICES)[0][0][0]
        self.page.mouse.move(*map(float, np.rint(self._wanted(mark))))
        self.page.mouse.wheel(0, -math.log(zoom) / WHEEL_LOG)
        self.page.wait_for_function(
            "([before, zoom]) => document.getElementById('board-svg').getScreenCTM().a > 0.9 * before * zoom",
            arg=[before, zoom],
        )


def misalignment(found: Floats, site: Site) -> Misalignment:
    """Compare an alignment (2, 3) with the truth."""
    corners = np.column_stack([site.corners, np.ones(len(site.corners))]).T
    off_m = np.linalg.norm(found @ corners - site.truth @ corners, axis=0)
    turns = [math.degrees(math.atan2(matrix[1, 0], matrix[0, 0])) for matrix in (found, site.truth)]
    turn_deg = abs((turns[0] - turns[1] + 180) % 360 - 180)
    sizes = [math.hypot(*matrix[:, 0]) for matrix in (found, site.truth)]
    return Misalignment(float(off_m.max()), float(off_m.mean()), turn_deg, 100 * abs(sizes[0] / sizes[1] - 1))


def worst(results: Sequence[Misalignment]) -> Misalignment:
    """Return the worst of each figure."""
    return Misalignment(
        max(each.largest_m for each in results),
        max(each.mean_m for each in results),
        max(each.turn_deg for each in results),
        max(each.size_percent for each in results),
    )


def _rotation(turn_rad: float) -> Floats:
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return np.array([[c, -s], [s, c]])


def _distance(a: Floats, b: Floats) -> float:
    return float(np.linalg.norm(a - b))
