"""A person's mouse and keyboard at a page, whose actions are counted; and a scan as a phone's app exports it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests import scenes
from tests.web.studio_page import click, mark, visit

# The app's world has y up, and its cameras look along -z with y up.
APP_FROM_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
APP_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
MILLIMETRES_PER_M = 1000


@dataclass(slots=True)
class Hands:
    """What a person does with mouse and keyboard, each action counted."""

    page: Any
    actions: int = 0

    def visit(self, name: str) -> None:
        """Go to a view of the studio."""
        visit(self.page, name)
        self.actions += 1

    def click(self, target: Any) -> None:
        """Click what is there."""
        target.click()
        self.actions += 1

    def press(self, name: str) -> None:
        """Click the button of a name."""
        self.click(self.page.get_by_role("button", name=name, exact=True))

    def spot(self, x: float, y: float) -> None:
        """Click a point of the plan."""
        click(self.page, x, y)
        self.actions += 1

    def type(self, target: Any, text: str) -> None:
        """Click a field, and type what is to be in it: two actions."""
        target.click()
        self.page.keyboard.press("ControlOrMeta+A")
        self.page.keyboard.type(text)
        self.actions += 2

    def write(self, text: str) -> None:
        """Type into the field that has the keyboard already."""
        self.page.keyboard.type(text)
        self.actions += 1

    def mark(self, target: Any, *shares: tuple[float, float]) -> None:
        """Click points of a picture, each a share of its width and height."""
        mark(target, *shares)
        self.actions += len(shares)

    def reload(self) -> None:
        """Load the page again."""
        self.page.reload()
        self.actions += 1

    def back(self) -> None:
        """Go back to the page before."""
        self.page.go_back()
        self.actions += 1

    def key(self, name: str) -> None:
        """Press a key."""
        self.page.keyboard.press(name)
        self.actions += 1

    def leave_field(self) -> None:
        """Leave a field, so that what is typed counts."""
        self.key("Tab")

    def finish(self) -> None:
        """End a line or an area."""
        self.press("Finish")

    def undo(self) -> None:
        """Take the last change back."""
        self.press("Undo")

    def redo(self) -> None:
        """Make it again."""
        self.press("Redo")

    def choose(self, target: Any, value: str) -> None:
        """Open a list, and choose from it: two actions."""
        target.select_option(value)
        self.actions += 2

    def file(self, target: Any, name: str, kind: str, data: bytes) -> None:
        """Press the button of a file field, and choose a file: two actions."""
        target.set_input_files({"name": name, "mimeType": kind, "buffer": data})
        self.actions += 2

    def drag(self, *points: tuple[float, float]) -> None:
        """Press the mouse at the first point of the screen, and let it go at the last."""
        self.page.mouse.move(*points[0])
        self.page.mouse.down()
        for point in points[1:]:
            self.page.mouse.move(*point, steps=4)
        self.page.mouse.up()
        self.actions += 1


def polycam_scan(views: Sequence[scenes.View]) -> bytes:
    """Return an archive as Polycam exports it: nobody has to state intrinsics, depth scale or gravity."""
    fx, fy, cx, cy = scenes.CAMERA.params
    files: dict[str, bytes] = {"mesh_info.json": b"{}"}
    for i, view in enumerate(views):
        matrix = APP_FROM_WORLD @ view.world_from_camera.matrix @ APP_CAMERA
        name = str(1_000_000 + 100_000 * i)
        entry = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "timestamp": int(name)}
        entry |= {"width": scenes.CAMERA.width, "height": scenes.CAMERA.height}
        entry |= {f"t_{row}{column}": matrix[row, column] for row in range(3) for column in range(4)}
        files[f"keyframes/images/{name}.jpg"] = view.jpeg()
        depth = np.rint(view.depth_m * MILLIMETRES_PER_M).astype(np.uint16)
        files[f"keyframes/depth/{name}.png"] = scenes.encode(depth, ".png")
        files[f"keyframes/cameras/{name}.json"] = json.dumps(entry).encode()
    return scenes.zipped(files)
