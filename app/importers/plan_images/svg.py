"""An SVG as a picture, by resvg, which has no network. References to anything outside the file are refused."""

from __future__ import annotations

import io
import math
import re
from xml.parsers import expat

import resvg_py
from PIL import Image

from app.errors import ImageTooLargeError, InvalidImageError
from app.importers.plan_images.order import OPTIONS, DrawOrder
from app.importers.plan_images.pictures import check_pixels

# resvg takes a millimetre of the file for this many pixels' part of an inch.
SVG_DPI = 96.0
UNITS_PX = {
    "": 1.0, "px": 1.0, "pt": SVG_DPI / 72, "pc": SVG_DPI / 6, "in": SVG_DPI, "cm": SVG_DPI / 2.54,
    "mm": SVG_DPI / 25.4,
}  # fmt: skip
LENGTH = re.compile(r"\s*([0-9.eE+]+)\s*(px|pt|pc|in|cm|mm)?\s*")
# A picture inside the file, but not a second SVG, which could refer to others again.
PICTURE_INSIDE = re.compile(r"\s*data:image/(?:png|jpe?g|gif|webp)[;,]", re.IGNORECASE)
OUTSIDE_URL = re.compile(r"url\(\s*['\"]?\s*(?![#'\"\s])|@import", re.IGNORECASE)


def draw_svg(data: bytes, order: DrawOrder) -> Image.Image:
    """Return the picture at `dpi`, on white; raises `InvalidImageError`, `ImageTooLargeError`."""
    if len(data) > OPTIONS.max_svg_bytes:
        raise ImageTooLargeError(f"The SVG has more than {OPTIONS.max_svg_bytes:,} bytes.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidImageError("The SVG is not UTF-8; save it so.") from None
    width, height = _checked(text)
    zoom = order.dpi / SVG_DPI
    check_pixels(width * zoom, height * zoom, order.max_pixels)
    try:
        png = resvg_py.svg_to_bytes(svg_string=text, dpi=SVG_DPI, zoom=zoom, background="white")
    except (ValueError, RuntimeError) as error:
        raise InvalidImageError(f"The SVG can't be drawn: {error}.") from None
    Image.MAX_IMAGE_PIXELS = None
    return Image.open(io.BytesIO(bytes(png))).convert("RGB")


def _checked(text: str) -> tuple[float, float]:
    """Return the size of an SVG in its pixels, after looking at every reference in it."""
    sizes: list[tuple[float, float]] = []

    def start(_: str, attributes: dict[str, str]) -> None:
        if not sizes:
            sizes.append(_size(attributes))
        for name, value in attributes.items():
            if name.rpartition(":")[2] == "href" and not value.strip().startswith("#"):
                if not PICTURE_INSIDE.match(value):
                    _refuse(value)
            elif OUTSIDE_URL.search(value):
                _refuse(value)

    def characters(content: str) -> None:
        if OUTSIDE_URL.search(content):
            _refuse(content)

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.CharacterDataHandler = characters
    parser.EntityDeclHandler = _refuse_entities
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InvalidImageError(f"The SVG is not valid XML: {error}.") from None
    return sizes[0]


def _refuse(value: str) -> None:
    raise InvalidImageError(
        f"The SVG refers to {value.strip()[:80]!r}; a plan must hold all of its parts. Embed pictures and styles, "
        "or export it as PDF or PNG."
    )


def _refuse_entities(*_: object) -> None:
    raise InvalidImageError("The SVG declares entities; save it without a DOCTYPE.")


def _size(attributes: dict[str, str]) -> tuple[float, float]:
    """Return width and height in the file's pixels, from the view box where they are not stated."""
    box = re.split(r"[\s,]+", attributes.get("viewBox", "").strip())
    found = []
    for name, row in (("width", 2), ("height", 3)):
        stated = LENGTH.fullmatch(attributes.get(name, ""))
        text = stated[1] if stated else box[row] if len(box) == 4 else ""
        try:
            found.append(float(text) * (UNITS_PX[stated[2] or ""] if stated else 1.0))
        except ValueError:
            raise InvalidImageError("The SVG needs width and height, or a viewBox.") from None
    if not all(math.isfinite(side) and side > 0 for side in found):
        raise InvalidImageError("The SVG needs a width and height above 0.")
    return found[0], found[1]
