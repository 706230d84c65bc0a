"""A picture of a scan's path from above, as SVG."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDE_PX = 640
MARGIN_PX = 40
# A short path is not drawn larger than this much of a room.
MIN_EXTENT_M = 1.0
GRID_STEPS_M = (0.1, 0.5, 1.0, 5.0, 10.0, 50.0, 100.0)
MAX_GRID_LINES = 12
# Arrows of the viewing direction, at most.
MAX_ARROWS = 60
ARROW_PX = 14.0


def path_picture(positions: Array, directions: Array, keyframes: Iterable[int]) -> str:
    """Return the SVG of a path: positions (n, 3) and optical axes (n, 3) in one frame, seen along -z.

    Green is the start, red the end, dots are the rows of `keyframes`; grid lines are a stated distance apart.
    """
    plane = positions[:, :2]
    low, high = plane.min(axis=0), plane.max(axis=0)
    extent = max(float((high - low).max()), MIN_EXTENT_M)
    middle = (low + high) / 2
    px_per_m = (SIDE_PX - 2 * MARGIN_PX) / extent
    # The picture's v points down.
    pixels = SIDE_PX / 2 + (plane - middle) * px_per_m * [1.0, -1.0]
    line = " ".join(f"{u:.1f},{v:.1f}" for u, v in pixels)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIDE_PX} {SIDE_PX}" font-size="12">',
        f'<rect width="{SIDE_PX}" height="{SIDE_PX}" fill="#fff"/>',
        *_grid(middle, extent, px_per_m),
        f'<polyline points="{line}" fill="none" stroke="#357" stroke-width="2"/>',
        *_arrows(pixels, directions[:, :2] * [1.0, -1.0]),
        *(f'<circle cx="{pixels[i, 0]:.1f}" cy="{pixels[i, 1]:.1f}" r="3" fill="#e80"/>' for i in keyframes),
        _end(pixels[0], "#292"),
        _end(pixels[-1], "#c22"),
        "</svg>",
    ]
    return "\n".join(parts)


def _grid(middle: Array, extent: float, px_per_m: float) -> list[str]:
    # A path longer than any building, by damaged poses, has as few lines as others.
    step = next((step for step in GRID_STEPS_M if extent / step <= MAX_GRID_LINES), extent / MAX_GRID_LINES)
    parts = []
    half = SIDE_PX / 2 / px_per_m
    for axis in (0, 1):
        first = np.ceil((middle[axis] - half) / step) * step
        for value in np.arange(first, middle[axis] + half, step):
            place = SIDE_PX / 2 + (value - middle[axis]) * px_per_m * (1.0 if axis == 0 else -1.0)
            ends = (place, 0, place, SIDE_PX) if axis == 0 else (0, place, SIDE_PX, place)
            x1, y1, x2, y2 = (f"{end:.1f}" for end in ends)
            parts.append(f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="#ddd"/>')
    parts.append(f'<text x="8" y="{SIDE_PX - 8}">grid {step:g} m</text>')
    return parts


def _arrows(pixels: Array, directions: Array) -> list[str]:
    step = max(1, len(pixels) // MAX_ARROWS)
    parts = []
    for (u, v), (du, dv) in zip(pixels[::step], directions[::step], strict=True):
        end = f'x2="{u + ARROW_PX * du:.1f}" y2="{v + ARROW_PX * dv:.1f}"'
        parts.append(f'<line x1="{u:.1f}" y1="{v:.1f}" {end} stroke="#9bc"/>')
    return parts


def _end(pixel: Array, color: str) -> str:
    return f'<circle cx="{pixel[0]:.1f}" cy="{pixel[1]:.1f}" r="6" fill="{color}"/>'
