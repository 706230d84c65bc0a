"""A person who has a keyboard and no mouse: all is reached by Tab, and points are set by the cross."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest

from tests.web.hands import Hands
from tests.web.live import KEY
from tests.web.studio_page import spot

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
# More presses of Tab than any page has places for it: what isn't reached by then can't be.
MOST_TABS = 150
MOST_MOVES = 60
# How far an arrow key moves the cross, pixels of the screen, and what is held with it.
STEPS = ((80, "Shift+"), (16, ""), (1, "Control+"))
NEAR_PX = 0.5
# A page reports it when a pointer is used after all.
NO_POINTER = """for (const name of ["pointerdown", "mousedown", "touchstart"])
    addEventListener(name, () => console.error("a pointer was used"), true);"""
MIDDLE = """(node) => { const { left, right, top, bottom } = node.getBoundingClientRect();
    return [(left + right) / 2, (top + bottom) / 2]; }"""
IS_BEHIND = """(node) =>
    Boolean(document.activeElement.compareDocumentPosition(node) & Node.DOCUMENT_POSITION_PRECEDING)"""
HAS_FOCUS = "(node) => node === document.activeElement"

Point = tuple[float, float]


@dataclass(slots=True)
class KeyboardHands(Hands):
    """What a person does with a keyboard alone. Presses of one key that follow each other are one action.

    Loading again, going back and choosing a file are the browser's own, which has keys for them.
    """

    presses: int = 0
    last: str = ""

    def open(self, address: str) -> None:
        """Open the studio with the key."""
        self.page.add_init_script(NO_POINTER)
        # While nobody listens a dialog of the system is opened and closed, and it takes a moment until it is known that
        # somebody does: longer than a key.
        self.page.on("filechooser", lambda _: None)
        self.page.goto(f"{address}/studio")
        self.type(self.page.get_by_label("Key", exact=True), KEY)
        self.key("Enter")
        self.page.get_by_role("dialog").first.wait_for(state="hidden")

    def key(self, name: str) -> None:
        """Press a key."""
        self.page.keyboard.press(name)
        self.presses += 1
        self.actions += name != self.last
        self.last = name

    def write(self, text: str) -> None:
        """Type into the field that has the keyboard."""
        self.page.keyboard.type(text)
        self.presses += len(text)
        self._other_action()

    def reach(self, target: Any) -> None:
        """Press Tab, or Shift and Tab, until an element has the keyboard."""
        playwright.expect(target).to_be_enabled()
        playwright.expect(target.locator("xpath=ancestor-or-self::*[@inert]")).to_have_count(0)
        playwright.expect(self.page.locator("[aria-busy=true]")).to_have_count(0)
        for _ in range(MOST_TABS):
            if target.evaluate(HAS_FOCUS):
                return
            self.key("Shift+Tab" if target.evaluate(IS_BEHIND) else "Tab")
        pytest.fail(f"{target} can't be reached by Tab")

    def click(self, target: Any) -> None:
        """Reach a button or a link, and press Enter."""
        self.reach(target)
        self.key("Enter")

    def visit(self, name: str) -> None:
        """Go to a view: by the link to the next one, or by the navigation."""
        following = self.page.locator(".next-view a:visible", has_text=f"Next: {name}")
        named = self.page.get_by_role("navigation", name="Steps").get_by_role("link", name=name, exact=True)
        self.click(following if following.count() else named)

    def type(self, target: Any, text: str) -> None:
        """Reach a field, and type what is to be in it."""
        self.reach(target)
        self.page.keyboard.press("ControlOrMeta+A")
        self.write(text)

    def choose(self, target: Any, value: str) -> None:
        """Reach a list, and type the beginning of what is chosen."""
        self.reach(target)
        self.write(target.locator(f"option[value={value}]").inner_text()[:3])
        playwright.expect(target).to_have_value(value)

    def file(self, target: Any, name: str, kind: str, data: bytes) -> None:
        """Reach a file field, press Space, and choose a file in the system's dialog: one action more."""
        self.reach(target)
        with self.page.expect_file_chooser() as chooser:
            self.key("Space")
        chooser.value.set_files({"name": name, "mimeType": kind, "buffer": data})
        self._other_action()

    def reload(self) -> None:
        """Load the page again, as F5 does."""
        self.page.reload()
        self._other_action()

    def back(self) -> None:
        """Go back to the page before, as Alt and the left arrow do."""
        self.page.go_back()
        self._other_action()

    def undo(self) -> None:
        """Take the last change back."""
        self.key("Control+Z")

    def redo(self) -> None:
        """Make it again."""
        self.key("Control+Y")

    def finish(self) -> None:
        """End a line or an area: Enter at its last point."""
        self.key("Enter")

    def spot(self, x: float, y: float) -> None:
        """Set a point of the plan."""
        self.reach(self.page.locator("#board"))
        self._aim("#board-svg", lambda: spot(self.page, x, y))
        self.key("Enter")

    def mark(self, target: Any, *shares: Point) -> None:
        """Set points of a picture, each a share of its width and height."""
        self.reach(target)
        for across, down in shares:
            self._aim("#picture", partial(_share, target, across, down))
            self.key("Enter")

    def drag(self, *points: Point) -> None:
        """Take hold at the first point of the screen, and let go at the last."""
        self.reach(self.page.locator("#board"))
        for i, point in enumerate(points):
            self._aim("#board-svg", partial(_same, point))
            if i in (0, len(points) - 1):
                self.key("Space")

    def _aim(self, drawing: str, target: Callable[[], Point]) -> None:
        """Move the cross of a drawing to a point of the screen, by large steps, then by small ones."""
        cross = self.page.locator(f"{drawing} .cross")
        playwright.expect(cross).to_have_attribute("visibility", "visible")
        for _ in range(MOST_MOVES):
            here, there = cross.evaluate(MIDDLE), target()
            right, down = there[0] - here[0], there[1] - here[1]
            if max(abs(right), abs(down)) <= NEAR_PX:
                return
            horizontal = abs(right) >= abs(down)
            away = right if horizontal else down
            step, held = next(each for each in STEPS if abs(away) >= each[0] or each[0] == 1)
            names = ("ArrowRight", "ArrowLeft") if horizontal else ("ArrowDown", "ArrowUp")
            for _ in range(max(1, int(abs(away) / step))):
                self.key(held + names[away < 0])
        pytest.fail("the cross does not arrive")

    def _other_action(self) -> None:
        self.actions += 1
        self.last = ""


def _same(point: Point) -> Point:
    return point


def _share(target: Any, across: float, down: float) -> Point:
    box = target.bounding_box()
    return box["x"] + box["width"] * across, box["y"] + box["height"] * down
