"""Paintings, drawn at random from a seed: the things that make one gallery wall differ from the next.

Each function takes a generator and a size in texels and returns an RGB image (h, w, 3), float32, 0 to 255.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.render.noise import cloud, fractal, stretched

Image = NDArray[np.float32]


def colour(rng: np.random.Generator, low: float = 20, high: float = 235) -> tuple[float, float, float]:
    """Return a random RGB colour, more saturated than three independent channels would be."""
    hue = rng.uniform(0, 2 * np.pi)
    value, saturation = rng.uniform(low, high), rng.uniform(0.05, 0.5)
    shades = value * (1 + saturation * np.cos(hue + np.array([0, 2.1, 4.2])))
    r, g, b = np.clip(shades, 0, 255)
    return float(r), float(g), float(b)


def canvas(rng: np.random.Generator, w: int, h: int, base: tuple[float, float, float]) -> Image:
    """Return a plain sheet with a faint cloud in it."""
    field = 1 + 0.04 * cloud(rng, h, w)[..., None]
    return np.asarray(np.array(base, np.float32) * field, dtype=np.float32)


def _finish(rng: np.random.Generator, image: Image) -> Image:
    h, w = image.shape[:2]
    weave = 0.025 * stretched(rng, h, w, 1.0, 1.0) + 0.05 * cloud(rng, h, w)
    return np.asarray(np.clip(image * (1 + weave[..., None]), 0, 255), dtype=np.float32)


def _shapes(rng: np.random.Generator, w: int, h: int) -> Image:
    image = canvas(rng, w, h, colour(rng))
    span = min(w, h)
    for _ in range(int(rng.integers(25, 60))):
        centre = rng.uniform(0, 1, 2) * (w, h)
        size = span * rng.uniform(0.02, 0.25)
        if rng.random() < 0.4:
            cv2.circle(
                image,
                (int(centre[0]), int(centre[1])),
                int(size / 2) + 2,
                colour(rng),
                int(rng.choice([-1, -1, 3])),
                cv2.LINE_AA,
            )
        else:
            corners = centre + rng.normal(0, size / 1.5, (int(rng.integers(3, 6)), 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], colour(rng), cv2.LINE_AA)
    return image


def _strokes(rng: np.random.Generator, w: int, h: int) -> Image:
    image = canvas(rng, w, h, colour(rng, 120, 235))
    for _ in range(int(rng.integers(60, 120))):
        start = rng.uniform(0, 1, 2) * (w, h)
        steps = np.cumsum(rng.normal(0, min(w, h) * 0.035, (12, 2)), axis=0)
        thick = int(rng.integers(2, max(4, min(w, h) // 22)))
        cv2.polylines(image, [(start + steps).astype(np.int32)], False, colour(rng), thick, cv2.LINE_AA)
    return image


def _landscape(rng: np.random.Generator, w: int, h: int) -> Image:
    top, bottom = np.array(colour(rng, 120, 220)), np.array(colour(rng, 170, 240))
    ramp = np.linspace(0, 1, h, dtype=np.float32)[:, None, None]
    image = np.asarray(top * (1 - ramp) + bottom * ramp + np.zeros((1, w, 1)), dtype=np.float32)
    image *= 1 + 0.08 * np.abs(cloud(rng, h, w))[..., None]
    for layer in range(5):
        level = h * (0.35 + 0.13 * layer)
        ridge = level + h * 0.06 * fractal(rng, 8, w, 1.1)[0] * (1.4 - 0.2 * layer)
        outline = np.column_stack([np.arange(w), ridge])
        outline = np.vstack([outline, [w, h], [0, h]])
        cv2.fillPoly(image, [outline.astype(np.int32)], colour(rng, 40, 190), cv2.LINE_AA)
        for _ in range(int(rng.integers(4, 16))):
            _tree(rng, image, int(rng.integers(0, w)), ridge, h)
    return image


def _tree(rng: np.random.Generator, image: Image, x: int, ridge: NDArray[np.float32], h: int) -> None:
    foot, size = int(ridge[x]), int(h * rng.uniform(0.03, 0.10)) + 3
    cv2.line(image, (x, foot), (x, foot - size), colour(rng, 20, 80), 2, cv2.LINE_AA)
    cv2.ellipse(image, ((x, foot - size), (size * 0.8, size * 1.2), 0), colour(rng, 30, 150), -1, cv2.LINE_AA)


def _grid(rng: np.random.Generator, w: int, h: int) -> Image:
    image = canvas(rng, w, h, (232, 228, 216))
    xs = [0, *sorted(rng.integers(w // 16, w - w // 16, 8).tolist()), w]
    ys = [0, *sorted(rng.integers(h // 16, h - h // 16, 7).tolist()), h]
    for x0, x1 in pairwise(xs):
        for y0, y1 in pairwise(ys):
            if rng.random() < 0.55:
                cv2.rectangle(image, (x0, y0), (x1, y1), colour(rng), -1)
            cv2.rectangle(image, (x0, y0), (x1, y1), (18, 18, 18), int(rng.integers(2, 5)))
    return image


def _rosettes(rng: np.random.Generator, w: int, h: int) -> Image:
    image = canvas(rng, w, h, colour(rng, 30, 120))
    for _ in range(int(rng.integers(12, 26))):
        centre, petals = rng.uniform(0, 1, 2) * (w, h), int(rng.integers(5, 11))
        size, tint, turn = min(w, h) * rng.uniform(0.05, 0.14), colour(rng, 90, 250), rng.uniform(0, 90)
        for k in range(petals):
            angle = turn + 360 * k / petals
            tip = centre + size * 0.7 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
            box = ((float(tip[0]), float(tip[1])), (float(size), float(size * 0.45)), float(angle))
            cv2.ellipse(image, box, tint, -1, cv2.LINE_AA)
        cv2.circle(
            image, (int(centre[0]), int(centre[1])), int(size * 0.25) + 1, colour(rng), -1, cv2.LINE_AA
        )
    return image


STYLES = (_shapes, _strokes, _landscape, _grid, _rosettes)
# Grids of black lines look alike to a feature detector, so few are hung.
STYLE_SHARES = (0.26, 0.24, 0.22, 0.04, 0.24)


def painting(rng: np.random.Generator, w: int, h: int) -> Image:
    """Return a framed painting in one of five styles."""
    image = _finish(rng, STYLES[int(rng.choice(len(STYLES), p=STYLE_SHARES))](rng, w, h))
    frame = colour(rng, 30, 120)
    edge = max(6, min(w, h) // 22)
    if rng.random() < 0.5:
        cv2.rectangle(image, (0, 0), (w - 1, h - 1), (236, 234, 228), 4 * edge)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), frame, 2 * edge)
    cv2.rectangle(image, (edge, edge), (w - 1 - edge, h - 1 - edge), tuple(0.5 * c for c in frame), 2)
    return image
