"""Printed and built things with an image each: posters, signs, books, boards, screens, doors, the outdoors.

Each function takes a generator, a size in texels and a text, and returns an RGB image (h, w, 3), 0 to 255.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.render.materials import MATERIALS
from bench.render.noise import cloud, fractal, seeded, stretched
from bench.venue.pictures import canvas, colour, painting

Image = NDArray[np.float32]
Printer = Callable[[np.random.Generator, int, int, str], Image]

WORDS = [
    "atlas",
    "amber",
    "basalt",
    "cedar",
    "chart",
    "copper",
    "delta",
    "ember",
    "fjord",
    "garden",
    "glacier",
    "harbour",
    "island",
    "ivory",
    "juniper",
    "kiln",
    "lantern",
    "lichen",
    "marble",
    "meadow",
    "mosaic",
    "north",
    "ochre",
    "orbit",
    "pebble",
    "quartz",
    "river",
    "saffron",
    "silver",
    "summit",
    "thistle",
    "tide",
    "timber",
    "tundra",
    "valley",
    "velvet",
    "willow",
    "winter",
    "open",
    "today",
    "free",
    "guided",
    "tour",
    "please",
    "quiet",
    "level",
    "exhibition",
    "history",
    "workshop",
    "evening",
    "music",
    "children",
    "family",
    "ticket",
    "hours",
    "monday",
    "sunday",
    "research",
    "collection",
    "garden",
    "lecture",
]
FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
)


def write(
    image: Image,
    text: str,
    left: float,
    base: float,
    height: float,
    ink: tuple[float, ...],
    font: int = cv2.FONT_HERSHEY_DUPLEX,
    weight: float = 0.1,
) -> float:
    """Draw a line of text `height` texels tall with its baseline at `base`; return its width."""
    scale = height / 22.0
    thick = max(1, round(height * weight))
    cv2.putText(image, text, (int(left), int(base)), font, scale, ink, thick, cv2.LINE_AA)
    return float(cv2.getTextSize(text, font, scale, thick)[0][0])


def fitted(
    image: Image, text: str, left: float, base: float, width: float, height: float, ink: tuple[float, ...]
) -> None:
    """Draw a line of text that is at most `width` wide and `height` tall."""
    natural = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, height / 22.0, max(1, round(height * 0.1)))[0][0]
    write(image, text, left, base, height * min(1.0, width / max(natural, 1)), ink)


def _paragraph(
    rng: np.random.Generator,
    image: Image,
    box: tuple[float, float, float, float],
    size: float,
    ink: tuple[float, ...],
) -> None:
    left, top, right, bottom = box
    font, base = int(rng.choice(FONTS)), top + size
    while base < bottom:
        x = left
        while x < right - 3 * size:
            x += write(image, str(rng.choice(WORDS)), x, base, size, ink, font) + size * 0.8
        base += size * 1.8


def poster(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A poster: a picture, a title and small print."""
    ground = colour(rng, 60, 240)
    image = canvas(rng, w, h, ground)
    ink = (250.0, 248.0, 240.0) if sum(ground) < 380 else (24.0, 22.0, 28.0)
    m = w * 0.07
    picture_h = int(h * rng.uniform(0.4, 0.55))
    picture = painting(rng, int(w - 2 * m), picture_h)
    top = int(h * (0.18 if rng.random() < 0.5 else 0.06))
    image[top : top + picture_h, int(m) : int(m) + picture.shape[1]] = picture
    title = text or " ".join(str(word) for word in rng.choice(WORDS, 2)).upper()
    title_base = h * 0.14 if top > h * 0.1 else top + picture_h + h * 0.13
    fitted(image, title, m, title_base, w - 2 * m, h * 0.1, ink)
    start = max(title_base + h * 0.04, top + picture_h + h * 0.03)
    _paragraph(rng, image, (m, start, w - m, h * 0.95), max(h * 0.025, 6), ink)
    return image


def sign(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A room's name plate."""
    dark = (38.0, 62.0, 96.0) if rng.random() < 0.5 else (44.0, 78.0, 60.0)
    image = canvas(rng, w, h, dark)
    cv2.rectangle(image, (3, 3), (w - 4, h - 4), (235, 235, 230), 2)
    fitted(image, text, w * 0.06, h * 0.68, w * 0.88, h * 0.5, (245, 245, 240))
    return image


def plate(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A small white card with print: the label beside a painting, or a room number."""
    image = canvas(rng, w, h, (240, 238, 232))
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (120, 118, 112), 2)
    if text:
        fitted(image, text, w * 0.1, h * 0.7, w * 0.8, h * 0.55, (30, 30, 34))
    else:
        _paragraph(rng, image, (w * 0.08, h * 0.1, w * 0.92, h * 0.95), max(h * 0.09, 5), (40, 40, 44))
    return image


def books(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """The open front of a shelf, full of books with a few gaps and objects."""
    del text
    image = canvas(rng, w, h, (58, 42, 30))
    shelves = max(1, round(h / 140))
    step = h / shelves
    for shelf in range(shelves):
        floor = int((shelf + 1) * step - 8)
        x = 6.0
        while x < w - 20:
            thick, tall = rng.uniform(8, 24), step * rng.uniform(0.55, 0.85)
            if rng.random() < 0.08:
                x += rng.uniform(10, 40)
                continue
            _spine(rng, image, int(x), int(min(x + thick, w - 6)), int(floor - tall), floor)
            x += thick + 1
        cv2.rectangle(image, (0, floor), (w, floor + 8), (150, 112, 72), -1)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (140, 104, 66), 10)
    return image


def _spine(rng: np.random.Generator, image: Image, x0: int, x1: int, y0: int, y1: int) -> None:
    tint = colour(rng, 40, 210)
    cv2.rectangle(image, (x0, y0), (x1, y1), tint, -1)
    cv2.line(image, (x0, y0), (x0, y1), tuple(0.5 * c for c in tint), 1)
    light = tuple(min(255.0, 1.6 * c + 40) for c in tint)
    for _ in range(int(rng.integers(1, 5))):
        y = int(rng.uniform(y0 + 4, y1 - 4))
        cv2.rectangle(image, (x0 + 2, y), (x1 - 2, y + int(rng.integers(1, 12))), light, -1)


def noticeboard(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A cork board with sheets of paper pinned to it."""
    image = canvas(rng, w, h, (176, 134, 88)) * (1 + 0.08 * stretched(rng, h, w, 1.2, 1.2)[..., None])
    image = np.asarray(image, dtype=np.float32)
    for _ in range(max(6, w * h // 16000)):
        sw, sh = int(rng.uniform(50, 110)), int(rng.uniform(60, 120))
        x, y = int(rng.uniform(8, max(9, w - sw - 8))), int(rng.uniform(8, max(9, h - sh - 8)))
        sheet = poster(rng, sw, sh, text) if rng.random() < 0.4 else plate(rng, sw, sh, "")
        room = image[y : y + sh, x : x + sw]
        room[:] = sheet[: room.shape[0], : room.shape[1]]
        cv2.circle(image, (x + sw // 2, y + 5), 4, colour(rng), -1, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (96, 66, 40), 12)
    return image


def whiteboard(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A white board with a little handwriting; mostly plain, as such boards are."""
    del text
    image = canvas(rng, w, h, (236, 238, 238))
    for _ in range(5):
        x, y = rng.uniform(0.05, 0.7) * w, rng.uniform(0.15, 0.85) * h
        ink = [(30.0, 50.0, 150.0), (160.0, 30.0, 40.0), (20.0, 110.0, 60.0)][int(rng.integers(3))]
        write(image, " ".join(str(s) for s in rng.choice(WORDS, 2)), x, y, h * 0.05, ink, FONTS[0], 0.08)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (150, 152, 156), 10)
    return image


def screen(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A display with a chart."""
    image = canvas(rng, w, h, (24, 34, 60))
    fitted(
        image, text or str(rng.choice(WORDS)).upper(), w * 0.06, h * 0.18, w * 0.7, h * 0.1, (230, 235, 245)
    )
    bars = int(rng.integers(6, 12))
    for k in range(bars):
        x0, x1 = w * (0.08 + 0.8 * k / bars), w * (0.08 + 0.8 * (k + 0.7) / bars)
        top = h * rng.uniform(0.3, 0.75)
        cv2.rectangle(image, (int(x0), int(top)), (int(x1), int(h * 0.85)), colour(rng, 110, 230), -1)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (14, 14, 16), 14)
    return image


def cardboard(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """The side of a cardboard box with tape and print."""
    del text
    image = canvas(rng, w, h, (176, 138, 96)) * (1 + 0.04 * stretched(rng, h, w, 1.0, 12)[..., None])
    image = np.asarray(image, dtype=np.float32)
    cv2.rectangle(image, (0, int(h * 0.46)), (w, int(h * 0.55)), (206, 184, 142), -1)
    ink = (70.0, 48.0, 34.0)
    fitted(image, str(rng.choice(WORDS)).upper(), w * 0.1, h * 0.36, w * 0.7, h * 0.16, ink)
    write(image, f"No {rng.integers(100, 999)}", w * 0.1, h * 0.78, h * 0.1, ink)
    label = plate(rng, max(24, w // 4), max(20, h // 5), "")
    y, x = int(h * 0.68), int(w * 0.66)
    room = image[y : y + label.shape[0], x : x + label.shape[1]]
    room[:] = label[: room.shape[0], : room.shape[1]]
    return image


def drawers(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """The front of a cabinet: drawers with handles and small labels."""
    del text
    image = _cover(rng, "wood_light" if rng.random() < 0.5 else "metal", w, h)
    rows, columns = max(1, round(h / 110)), max(1, round(w / 180))
    for row in range(rows):
        for column in range(columns):
            x0, x1 = column * w // columns + 3, (column + 1) * w // columns - 3
            y0, y1 = row * h // rows + 3, (row + 1) * h // rows - 3
            cv2.rectangle(image, (x0, y0), (x1, y1), (60, 50, 42), 2)
            middle = (x0 + x1) // 2
            cv2.rectangle(image, (middle - 18, y0 + 18), (middle + 18, y0 + 24), (40, 40, 44), -1)
            cv2.rectangle(image, (middle - 14, y0 + 34), (middle + 14, y0 + 48), (236, 232, 220), -1)
            write(image, f"{rng.integers(10, 99)}", middle - 8, y0 + 46, 9, (40, 40, 40))
    return image


def door(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A closed door leaf."""
    del text
    image = _cover(rng, "wood_light", w, h)
    for y0, y1 in ((0.07, 0.45), (0.55, 0.93)):
        cv2.rectangle(image, (int(w * 0.15), int(h * y0)), (int(w * 0.85), int(h * y1)), (84, 60, 40), 3)
    cv2.rectangle(image, (int(w * 0.86), int(h * 0.49)), (int(w * 0.97), int(h * 0.51)), (60, 62, 66), -1)
    return image


def vending(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """The lit front of a vending machine."""
    image = canvas(rng, w, h, colour(rng, 60, 160))
    fitted(image, text or "FRESH DRINKS", w * 0.08, h * 0.09, w * 0.8, h * 0.05, (250, 250, 240))
    x1, y1 = int(w * 0.74), int(h * 0.85)
    cv2.rectangle(image, (int(w * 0.06), int(h * 0.12)), (x1, y1), (20, 24, 28), -1)
    for row in range(6):
        for column in range(5):
            x, y = int(w * (0.09 + 0.13 * column)), int(h * (0.15 + 0.115 * row))
            cv2.rectangle(image, (x, y), (x + int(w * 0.09), y + int(h * 0.08)), colour(rng, 90, 240), -1)
            cv2.rectangle(
                image, (x, y + int(h * 0.03)), (x + int(w * 0.09), y + int(h * 0.045)), colour(rng), -1
            )
    cv2.rectangle(image, (int(w * 0.8), int(h * 0.3)), (int(w * 0.94), int(h * 0.45)), (210, 214, 216), -1)
    return image


def lamp(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A ceiling light panel with its grid."""
    del text
    image = canvas(rng, w, h, (250, 249, 242))
    for k in range(1, 4):
        cv2.line(image, (w * k // 4, 0), (w * k // 4, h), (206, 206, 202), 3)
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (170, 172, 174), 8)
    return image


def socket(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """A white wall socket, or a light switch where the text says so."""
    image = canvas(rng, w, h, (232, 231, 226))
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (176, 175, 170), 1)
    if text == "switch":
        cv2.rectangle(image, (w // 5, h // 5), (w - w // 5, h - h // 5), (196, 195, 190), 1)
        return image
    cv2.circle(image, (w // 2, h // 2), max(3, round(0.34 * w)), (170, 169, 165), 1, cv2.LINE_AA)
    for side in (-1, 1):
        cv2.circle(image, (w // 2 + round(side * 0.14 * w), h // 2), 1, (52, 50, 48), -1, cv2.LINE_AA)
    return image


def outdoors(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    """Sky, hills and trees as seen through the windows."""
    del text
    ramp = np.linspace(0, 1, h, dtype=np.float32)[:, None, None]
    top, bottom = np.array([140, 176, 222], np.float32), np.array([224, 232, 238], np.float32)
    image = top * (1 - ramp) + bottom * ramp
    clouds = np.clip(cloud(rng, h, w), 0, 2)[..., None]
    image = np.asarray(image + 14 * clouds, dtype=np.float32)
    for layer, shade in enumerate(((120, 140, 130), (88, 116, 84), (70, 98, 56))):
        ridge = h * (0.76 + 0.06 * layer) + h * 0.03 * fractal(rng, 4, w, 1.3)[0]
        outline = np.vstack([np.column_stack([np.arange(w), ridge]), [w, h], [0, h]])
        cv2.fillPoly(image, [outline.astype(np.int32)], shade, cv2.LINE_AA)
        for _ in range(160):
            x = int(rng.integers(0, w))
            size = h * rng.uniform(0.02, 0.06) * (1 + layer * 0.5)
            box = ((float(x), float(ridge[x])), (size * 0.7, size * 1.4), 0.0)
            cv2.ellipse(image, box, tuple(float(s * rng.uniform(0.7, 1.1)) for s in shade), -1, cv2.LINE_AA)
    return image


@lru_cache(maxsize=4)
def _sheet(material: str) -> Image:
    return MATERIALS[material](seeded("sheet", material))


def _cover(rng: np.random.Generator, material: str, w: int, h: int) -> Image:
    """Return a piece (h, w, 3) of a material, cut from a random place."""
    tile, (y, x) = _sheet(material), rng.integers(0, 512, 2)
    rows, columns = (np.arange(h) + y) % tile.shape[0], (np.arange(w) + x) % tile.shape[1]
    return np.ascontiguousarray(tile[rows][:, columns])


def _painting(rng: np.random.Generator, w: int, h: int, text: str) -> Image:
    del text
    return painting(rng, w, h)


PRINTS: dict[str, Printer] = {
    "painting": _painting,
    "poster": poster,
    "sign": sign,
    "plate": plate,
    "books": books,
    "noticeboard": noticeboard,
    "whiteboard": whiteboard,
    "screen": screen,
    "cardboard": cardboard,
    "drawers": drawers,
    "door": door,
    "vending": vending,
    "lamp": lamp,
    "socket": socket,
    "outdoors": outdoors,
}
