"""The picture of docs/axes.md: the cube as the camera of each convention sees it, with the world's and its own axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes as Panel
from matplotlib.patches import Polygon

from app.api.requests.axes import CONVENTIONS, AxesName
from bench.axes.cube import (
    DIRECTIONS,
    HEIGHT_PX,
    SIDE_M,
    WIDTH_PX,
    Array,
    camera_pose,
    corners_m,
    pixels_of,
)
from bench.reports.plot_style import new_figure, save

# Conventions that are alike share a panel.
PANELS: tuple[tuple[AxesName, str], ...] = (
    ("opencv", "opencv (Roomfix)"),
    ("arkit", "arkit, arcore, webxr"),
    ("unity", "unity (left-handed)"),
    ("unreal", "unreal (left-handed, cm)"),
    ("ros", "ros"),
)
# x, y and z.
COLOURS = ("#D55E00", "#009E73", "#0072B2")
# The sides of the cube that the camera sees, by corners of `corners_m`: towards +x, towards -y, and the top.
FACES = ((4, 5, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3))
SHADES = ("#d9d9d9", "#bdbdbd", "#efefef")
AXIS_M = 1.4 * SIDE_M
# The camera's own axes are drawn in a corner of the picture: here, this long, and what is ahead aslant.
INSET_PX = np.array([62.0, 70.0])
INSET_SIZE_PX = 38.0
AHEAD_DRAWN = np.array([0.62, -0.45])


def draw_axes(path: Path) -> Path:
    """Write the picture and return where."""
    figure = new_figure(15.0, 3.1)
    for number, (name, title) in enumerate(PANELS, 1):
        panel = figure.add_subplot(1, len(PANELS), number)
        panel.set_xlim(0, WIDTH_PX)
        panel.set_ylim(HEIGHT_PX, 0)
        panel.set_aspect("equal")
        panel.set_xticks([])
        panel.set_yticks([])
        panel.set_title(title, fontsize=10)
        _draw_cube(panel, name)
        _draw_world(panel, name)
        _draw_camera(panel, name)
    return save(figure, path)


def _draw_cube(panel: Panel, name: AxesName) -> None:
    pixels = pixels_of(name, corners_m())
    for face, shade in zip(FACES, SHADES, strict=True):
        panel.add_patch(Polygon(pixels[list(face)], facecolor=shade, edgecolor="#555555", linewidth=0.8))


def _draw_world(panel: Panel, name: AxesName) -> None:
    """Draw the axes of the convention's world at its origin, a corner of the cube."""
    start = pixels_of(name, np.zeros((1, 3)))[0]
    for axis, colour, letter in zip(CONVENTIONS[name].world, COLOURS, "xyz", strict=True):
        _arrow(panel, start, pixels_of(name, AXIS_M * axis[None])[0], colour, letter)


def _draw_camera(panel: Panel, name: AxesName) -> None:
    """Draw the axes of the convention's camera, and write where it stands."""
    own = DIRECTIONS[name]
    drawn = np.column_stack([own.right, own.up, own.forward]) @ np.array([[1, 0], [0, -1], AHEAD_DRAWN])
    for direction, colour, letter in zip(drawn, COLOURS, "xyz", strict=True):
        _arrow(panel, INSET_PX, INSET_PX + INSET_SIZE_PX * direction, colour, letter)
    position = ", ".join(f"{value:g}" for value in CONVENTIONS[name].pose_out(camera_pose()).translation)
    panel.text(6, HEIGHT_PX - 6, f"camera at ({position})", fontsize=8)


def _arrow(panel: Panel, start: Array, end: Array, colour: str, letter: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=style)
    direction = (end - start) / np.linalg.norm(end - start)
    x, y = end + 10 * direction
    panel.text(float(x), float(y), letter, color=colour, ha="center", va="center", fontsize=10)
