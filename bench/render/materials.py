"""Periodic surface materials (walls, floors, ceilings, furniture) as functions of a seeded generator.

Each returns an RGB image (n, n, 3), float32, 0 to 255, that tiles without a seam.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.render.noise import Field, fractal, stretched

Image = NDArray[np.float32]
Colour = tuple[float, float, float]
Maker = Callable[[np.random.Generator], Image]

LARGE = 1024
SMALL = 512


def _tinted(colour: Colour, field: Field) -> Image:
    """Return `colour` scaled by 1 + field, per texel."""
    return np.asarray(np.array(colour, np.float32) * (1 + field[..., None]), dtype=np.float32)


def _plaster(rng: np.random.Generator, colour: Colour, strength: float = 1.0) -> Image:
    n = LARGE
    field = (
        0.022 * fractal(rng, n, n, 1.0)
        + 0.026 * stretched(rng, n, n, 2.2, 2.2)
        + 0.012 * fractal(rng, n, n, 0.3)
    )
    dents = stretched(rng, n, n, 5, 3)
    field -= 0.10 * np.clip(dents - 2.2, 0, 1) - 0.06 * np.clip(-dents - 2.4, 0, 1)
    return _tinted(colour, strength * field)


def _plain(rng: np.random.Generator, colour: Colour) -> Image:
    return _tinted(colour, 0.006 * fractal(rng, SMALL, SMALL, 1.5))


def _cells(n: int, rows: int, columns: int, shift: float) -> tuple[NDArray[np.int64], Field, Field]:
    """Return each texel's cell number, and its place (0 to 1) across and down in it; odd rows move by
    `shift`."""
    y, x = np.mgrid[0:n, 0:n].astype(np.float32) + 0.5
    v = y * rows / n
    row = np.floor(v).astype(np.int64)
    u = (x * columns / n + shift * (row % 2)) % columns
    column = np.floor(u).astype(np.int64)
    return row * columns + column, (u - column).astype(np.float32), (v - row).astype(np.float32)


def _joint(across: Field, down: Field, width_x: float, width_y: float) -> Field:
    """Return 1 in the joints between cells, 0 inside, with a soft border."""
    dx = np.minimum(across, 1 - across) / width_x
    dy = np.minimum(down, 1 - down) / width_y
    return np.asarray(np.clip(1.5 - np.minimum(dx, dy), 0, 1), dtype=np.float32)


def _brick(rng: np.random.Generator, colour: Colour, mortar: Colour) -> Image:
    n, rows, columns = LARGE, 48, 16
    cell, across, down = _cells(n, rows, columns, 0.5)
    tone = rng.normal(0, 0.13, rows * columns).astype(np.float32)[cell]
    field = tone + 0.08 * stretched(rng, n, n, 2, 1.5) + 0.06 * fractal(rng, n, n, 1.0)
    joint = _joint(across, down, 0.025, 0.075)[..., None]
    grout = _tinted(mortar, 0.06 * fractal(rng, n, n, 0.5))
    return np.asarray(_tinted(colour, field) * (1 - joint) + grout * joint, dtype=np.float32)


def _grain(rng: np.random.Generator, n: int, along_x: bool = True) -> Field:
    """Return wood grain (n, n): long fibres and wavy year rings."""
    fibres = stretched(rng, n, n, 40, 0.8) if along_x else stretched(rng, n, n, 0.8, 40)
    warp = stretched(rng, n, n, 70, 8) if along_x else stretched(rng, n, n, 8, 70)
    fine = stretched(rng, n, n, 8, 0.6) if along_x else stretched(rng, n, n, 0.6, 8)
    rings = np.sin(5 * warp)
    return np.asarray(0.05 * fibres + 0.06 * rings + 0.04 * fine, dtype=np.float32)


def _parquet(rng: np.random.Generator, colour: Colour) -> Image:
    n, rows, columns = LARGE, 32, 4
    cell, across, down = _cells(n, rows, columns, 0.5)
    tone = rng.normal(0, 0.12, rows * columns).astype(np.float32)[cell]
    # Each plank shows another part of the grain, as if cut from another tree.
    shift_y, shift_x = rng.integers(0, n, (2, rows * columns))
    y, x = np.mgrid[0:n, 0:n]
    grain = 1.4 * _grain(rng, n)[(y + shift_y[cell]) % n, (x + shift_x[cell]) % n]
    joint = _joint(across, down, 0.006, 0.05)[..., None]
    return np.asarray(_tinted(colour, tone + grain) * (1 - 0.55 * joint), dtype=np.float32)


def _wood(rng: np.random.Generator, colour: Colour) -> Image:
    return _tinted(colour, 1.3 * _grain(rng, SMALL) + 0.04 * fractal(rng, SMALL, SMALL, 1.2))


def _wood_panel(rng: np.random.Generator, colour: Colour) -> Image:
    n = LARGE
    cell, across, down = _cells(n, 2, 16, 0.0)
    tone = rng.normal(0, 0.10, 32).astype(np.float32)[cell]
    joint = _joint(across, down, 0.03, 0.006)[..., None]
    return np.asarray(
        _tinted(colour, tone + 1.3 * _grain(rng, n, along_x=False)) * (1 - 0.6 * joint), dtype=np.float32
    )


def _carpet(rng: np.random.Generator, colour: Colour, second: Colour) -> Image:
    n = LARGE
    base = _tinted(colour, 0.12 * stretched(rng, n, n, 0.8, 0.8) + 0.05 * fractal(rng, n, n, 1.1))
    mask = np.zeros((n, n), np.float32)
    for _ in range(420):
        centre = rng.integers(0, n, 2)
        size = rng.integers(8, 34, 2)
        for dx in (-n, 0, n):
            for dy in (-n, 0, n):
                where = (int(centre[0]) + dx, int(centre[1]) + dy)
                box = (where, (int(size[0]), int(size[1])), float(rng.integers(0, 4) * 45))
                cv2.ellipse(mask, box, float(0.3 + 0.7 * (centre[0] % 7) / 7), -1, cv2.LINE_AA)
    pattern = 0.75 * mask[..., None]
    thread = _tinted(second, 0.12 * stretched(rng, n, n, 0.8, 0.8))
    return np.asarray(base * (1 - pattern) + thread * pattern, dtype=np.float32)


def _stone(rng: np.random.Generator, colour: Colour, other: Colour, cells: int = 8) -> Image:
    """Square tiles with veins, each of its own tone; `other` colours every second one."""
    n = LARGE
    cell, across, down = _cells(n, cells, cells, 0.0)
    shift_y, shift_x = rng.integers(0, n, (2, cells * cells))
    y, x = np.mgrid[0:n, 0:n]
    veins = np.exp(-np.abs(fractal(rng, n, n, 1.6)) * 14) * 0.35
    cloud = 0.05 * fractal(rng, n, n, 1.2) + 0.025 * stretched(rng, n, n, 1.2, 1.2)
    field = (cloud - veins)[(y + shift_y[cell]) % n, (x + shift_x[cell]) % n]
    field += rng.normal(0, 0.05, cells * cells).astype(np.float32)[cell]
    odd = ((cell // cells + cell % cells) % 2)[..., None].astype(np.float32)
    image = _tinted(colour, field) * (1 - odd) + _tinted(other, field) * odd
    joint = _joint(across, down, 0.012, 0.012)[..., None]
    return np.asarray(image * (1 - 0.4 * joint), dtype=np.float32)


def _terrazzo(rng: np.random.Generator, colour: Colour) -> Image:
    n = LARGE
    image = _tinted(colour, 0.03 * fractal(rng, n, n, 1.0))
    palette = np.array(
        [(92, 84, 76), (150, 96, 70), (214, 206, 190), (70, 78, 88), (176, 160, 120)], np.float32
    )
    for _ in range(3200):
        corners = rng.normal(0, rng.uniform(2.0, 7.0), (5, 2)) + rng.uniform(0, n, 2)
        chip = cv2.convexHull(corners.astype(np.float32))
        shade = (palette[rng.integers(len(palette))] * rng.uniform(0.8, 1.15)).tolist()
        for dx in (-n, 0, n):
            for dy in (-n, 0, n):
                moved = chip + np.array([dx, dy], np.float32)
                if moved.max() > 0 and moved.min() < n:
                    cv2.fillConvexPoly(image, (moved * 16).astype(np.int32), shade, cv2.LINE_AA, 4)
    return image


def _linoleum(rng: np.random.Generator, colour: Colour) -> Image:
    n = LARGE
    field = 0.06 * stretched(rng, n, n, 2.0, 1.2) + 0.05 * fractal(rng, n, n, 1.0)
    specks = stretched(rng, n, n, 1.3, 1.3)
    return _tinted(colour, field + 0.3 * np.clip(specks - 2.3, 0, 1) - 0.3 * np.clip(-specks - 2.3, 0, 1))


def _concrete(rng: np.random.Generator) -> Image:
    n = LARGE
    field = 0.07 * fractal(rng, n, n, 1.2) + 0.03 * fractal(rng, n, n, 0.5)
    pores = np.clip(stretched(rng, n, n, 1.4, 1.4) - 2.6, 0, 1)
    cracks = np.exp(-np.abs(fractal(rng, n, n, 1.7)) * 60) * 0.18
    return _tinted((158, 156, 150), field - 0.5 * pores - cracks)


def _ceiling(rng: np.random.Generator, cells: int) -> Image:
    n = LARGE
    cell, across, down = _cells(n, cells, cells, 0.0)
    tone = rng.normal(0, 0.015, cells * cells).astype(np.float32)[cell]
    holes = np.clip(stretched(rng, n, n, 1.2, 1.2) - 1.9, 0, 1)
    joint = _joint(across, down, 0.018, 0.018)
    return _tinted((226, 225, 220), tone + 0.02 * fractal(rng, n, n, 1.0) - 0.25 * holes - 0.3 * joint)


def _wallpaper(rng: np.random.Generator) -> Image:
    n, step = LARGE, 128
    image = _tinted((196, 184, 150), 0.03 * fractal(rng, n, n, 0.8))
    motif = np.zeros((step, step), np.float32)
    for _ in range(9):
        angle, size = rng.uniform(0, 180), rng.uniform(8, 22)
        box = ((step / 2 + rng.normal(0, 18), step / 2 + rng.normal(0, 18)), (size * 2, size), angle)
        cv2.ellipse(motif, box, float(rng.uniform(0.3, 1)), 2, cv2.LINE_AA)
    motif = np.maximum(motif, motif[:, ::-1])
    pattern = np.tile(motif, (n // step, n // step))[..., None] * 0.6
    return np.asarray(image * (1 - pattern) + np.array([120, 70, 60], np.float32) * pattern, dtype=np.float32)


def _wall_tile(rng: np.random.Generator) -> Image:
    n, cells = LARGE, 24
    cell, across, down = _cells(n, cells, cells, 0.0)
    palette = np.array([(228, 232, 230)] * 6 + [(120, 168, 180), (80, 122, 150), (196, 214, 210)], np.float32)
    image = palette[rng.integers(0, len(palette), cells * cells)][cell]
    image = image * (1 + 0.02 * fractal(rng, n, n, 1.0)[..., None])
    return np.asarray(image * (1 - 0.3 * _joint(across, down, 0.03, 0.03)[..., None]), dtype=np.float32)


def _metal(rng: np.random.Generator) -> Image:
    field = 0.05 * stretched(rng, SMALL, SMALL, 30, 0.7) + 0.04 * fractal(rng, SMALL, SMALL, 1.3)
    return _tinted((168, 172, 176), field)


def _fabric(rng: np.random.Generator, colour: Colour) -> Image:
    n = SMALL
    y, x = np.mgrid[0:n, 0:n]
    weave = 0.06 * np.sign(np.sin(x * 2 * np.pi / 8) * np.sin(y * 2 * np.pi / 8))
    field = weave + 0.08 * stretched(rng, n, n, 1.0, 1.0) + 0.06 * fractal(rng, n, n, 1.1)
    return _tinted(colour, field.astype(np.float32))


def _leaves(rng: np.random.Generator) -> Image:
    n = SMALL
    image = _tinted((34, 52, 28), 0.2 * fractal(rng, n, n, 0.8))
    for _ in range(700):
        shade = (np.array((70, 120, 48)) * rng.uniform(0.5, 1.5) + rng.normal(0, 8, 3)).tolist()
        box = (tuple(rng.uniform(0, n, 2)), tuple(rng.uniform(10, 40, 2)), rng.uniform(0, 180))
        cv2.ellipse(image, box, shade, -1, cv2.LINE_AA)
    return image


MATERIALS: dict[str, Maker] = {
    "plaster_white": partial(_plaster, colour=(222, 220, 214)),
    "plaster_sand": partial(_plaster, colour=(206, 186, 152)),
    "plaster_cream": partial(_plaster, colour=(218, 210, 186), strength=0.6),
    "plaster_blue": partial(_plaster, colour=(150, 172, 192)),
    "plaster_green": partial(_plaster, colour=(160, 180, 150)),
    "plaster_red": partial(_plaster, colour=(158, 92, 82)),
    "plain_white": partial(_plain, colour=(226, 226, 222)),
    "plain_grey": partial(_plain, colour=(168, 166, 162)),
    "plain_dark": partial(_plain, colour=(48, 48, 52)),
    "brick_red": partial(_brick, colour=(158, 88, 66), mortar=(188, 180, 168)),
    "brick_white": partial(_brick, colour=(206, 202, 192), mortar=(150, 146, 138)),
    "wood_panel": partial(_wood_panel, colour=(152, 106, 66)),
    "wallpaper": _wallpaper,
    "wall_tile": _wall_tile,
    "parquet_oak": partial(_parquet, colour=(182, 138, 88)),
    "parquet_dark": partial(_parquet, colour=(108, 74, 50)),
    "carpet_grey": partial(_carpet, colour=(104, 106, 112), second=(150, 128, 92)),
    "carpet_red": partial(_carpet, colour=(120, 48, 48), second=(176, 140, 84)),
    "stone_tile": partial(_stone, colour=(190, 182, 168), other=(178, 168, 152)),
    "stone_check": partial(_stone, colour=(206, 202, 194), other=(86, 84, 84), cells=10),
    "terrazzo": partial(_terrazzo, colour=(196, 190, 178)),
    "linoleum_grey": partial(_linoleum, colour=(142, 146, 148)),
    "linoleum_green": partial(_linoleum, colour=(124, 146, 128)),
    "linoleum_blue": partial(_linoleum, colour=(112, 130, 150)),
    "concrete": _concrete,
    "ceiling_tile": partial(_ceiling, cells=8),
    "ceiling_panel": partial(_ceiling, cells=4),
    "wood_light": partial(_wood, colour=(190, 150, 102)),
    "wood_dark": partial(_wood, colour=(112, 72, 44)),
    "metal": _metal,
    "fabric_blue": partial(_fabric, colour=(62, 88, 130)),
    "fabric_red": partial(_fabric, colour=(148, 58, 50)),
    "fabric_grey": partial(_fabric, colour=(120, 120, 118)),
    "leaves": _leaves,
    "grass": partial(_linoleum, colour=(96, 128, 70)),
}
