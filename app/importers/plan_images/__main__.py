"""Draws one plan file: `python -m app.importers.plan_images SOURCE PICTURE TILES`; the order comes as JSON on stdin.

A process of its own, for the files come from anywhere and the libraries that read them are large: what one takes in
memory or time is bounded, and its end harms nobody.
"""

from __future__ import annotations

import json
import math
import resource
import sys
from dataclasses import asdict, replace
from pathlib import Path

from PIL import Image

from app.errors import InvalidImageError, RoomfixError
from app.importers.plan_images.order import OPTIONS, SHOWN_KINDS, Drawn, DrawOrder
from app.importers.plan_images.pictures import read_picture
from app.importers.plan_images.tiles import write_tiles


def draw(data: bytes, order: DrawOrder, tiles: Path) -> tuple[Image.Image, Drawn]:
    """Return the picture of a plan file, and its size before it was reduced to what is shown; write its tiles where
    they are wanted and it has many pixels."""
    drawn = None
    if order.kind == "pdf":
        from app.importers.plan_images.pdf import draw_page

        image = draw_page(data, order)
    elif order.kind == "svg":
        from app.importers.plan_images.svg import draw_svg

        image = draw_svg(data, order)
    elif order.kind == "dxf":
        from app.importers.plan_images.dxf import draw_dxf

        image, drawn = draw_dxf(data, order)
    else:
        image = read_picture(data, order)
    drawn = drawn or Drawn(width_px=image.width, height_px=image.height)
    has_tiles = order.has_tiles and image.width * image.height > OPTIONS.min_tiled_pixels
    if has_tiles:
        write_tiles(image, tiles)
    factor = math.ceil(math.sqrt(image.width * image.height / order.shown_pixels))
    drawn = replace(drawn, reduced_by=factor, has_tiles=has_tiles)
    return (image if factor == 1 else image.reduce(factor)), drawn


def main(source: Path, picture: Path, tiles: Path) -> None:
    """Draw by the order on standard input; what came of it, or the error, goes to standard output."""
    order = DrawOrder(**json.load(sys.stdin))
    resource.setrlimit(resource.RLIMIT_AS, (OPTIONS.memory_bytes, OPTIONS.memory_bytes))
    seconds = max(1, int(order.timeout_s))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        image, drawn = draw(source.read_bytes(), order, tiles)
        if drawn.reduced_by > 1 or order.kind not in SHOWN_KINDS:
            image.save(picture, format="PNG")
        answer = asdict(drawn)
    except RoomfixError as error:
        answer = {"error": type(error).__name__, "message": str(error)}
    except (MemoryError, RecursionError):
        message = "The plan needs too much memory to be drawn; send a simpler file, or choose a lower dpi."
        answer = {"error": InvalidImageError.__name__, "message": message}
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main(*(Path(path) for path in sys.argv[1:]))
