"""What is to be drawn from a plan file, what came of it, and which kinds of files there are."""

from __future__ import annotations

import re
from dataclasses import dataclass

from app.limits import limit

INCH_M = 0.0254
UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": INCH_M, "ft": 0.3048}
# Where the name of a format must stand in a file.
HEAD_BYTES = 8192
PDF_HEAD_BYTES = 1024
# Programs write long comments and definitions before it.
SVG_HEAD_BYTES = 1_000_000
MAGIC = {
    "png": (b"\x89PNG",),
    "jpeg": (b"\xff\xd8\xff",),
    "tiff": (b"II\x2a\x00", b"MM\x00\x2a", b"II\x2b\x00", b"MM\x00\x2b"),
    "dxf": (b"AutoCAD Binary DXF",),
}
# What is stored and shown as it was sent; everything else is drawn.
SHOWN_KINDS = {"png": "image/png", "jpeg": "image/jpeg"}
TEXT_DXF = re.compile(rb"\s*(?:999\s*\n|0\s*\n\s*SECTION)")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanImageOptions:
    """How plan files are drawn."""

    max_pixels: int = limit(
        400_000_000,
        "A plan with more pixels is refused before it is drawn.",
        chosen="By hand: a sheet of 1.2 x 0.85 m at 500 dots an inch; 1.6 GB in colour while it is drawn.",
    )
    min_tiled_pixels: int = limit(
        16_000_000,
        "A plan with more pixels is stored as tiles too.",
        chosen="By hand: browsers of phones show no picture of more than about 16.7 million pixels sharply.",
    )
    memory_bytes: int = limit(
        4_000_000_000,
        "Address space of the process that draws a plan.",
        chosen="By hand: twice the largest picture in colour, and the libraries.",
    )
    timeout_s: float = limit(
        120.0,
        "Time that drawing a plan may take.",
        chosen="By hand: the largest pictures take half a minute.",
    )
    drawn_dxf_px: int = limit(
        4_000,
        "Longer side of a drawn DXF when no metres per pixel are given.",
        chosen="By hand: 2 cm a pixel for a building of 80 m.",
    )
    max_dxf_lines: int = limit(
        2_000_000,
        "Straight pieces that a DXF is drawn with.",
        chosen="By hand: drawn in some seconds; a storey with furniture has 100,000.",
    )
    dxf_curve_px: float = limit(
        0.5, "Largest distance of a drawn curve from the true one.", chosen="By hand: not seen."
    )
    max_svg_bytes: int = limit(
        30_000_000, "Largest SVG.", chosen="By hand: a storey with all its hatching has a few megabytes."
    )


OPTIONS = PlanImageOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawOrder:
    """`meters_per_pixel` and `units` (of the file's numbers) matter for DXF, `dpi` for PDF and SVG, `page` (from 1) for
    PDF and TIFF. A picture of more than `shown_pixels` is reduced by a whole number; with `has_tiles` one of many
    pixels is cut into tiles before that."""

    kind: str
    page: int = 1
    dpi: float = 150.0
    meters_per_pixel: float | None = None
    units: str | None = None
    max_pixels: int = OPTIONS.max_pixels
    shown_pixels: int = OPTIONS.max_pixels
    has_tiles: bool = False
    timeout_s: float = OPTIONS.timeout_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """Size of the drawn picture, and by how much it was reduced after that.

    With `has_tiles` all its pixels were written as tiles too. For DXF: metres of a pixel, and the pixel of the
    drawing's (0, 0), both before the reduction.
    """

    width_px: int
    height_px: int
    reduced_by: int = 1
    has_tiles: bool = False
    meters_per_pixel: float | None = None
    origin_px: tuple[float, float] | None = None


def kind_of(data: bytes) -> str | None:
    """Return the kind of a plan file by its first bytes: png, jpeg, tiff, pdf, svg or dxf."""
    head = data[:HEAD_BYTES].removeprefix(b"\xef\xbb\xbf")
    for kind, magics in MAGIC.items():
        if head.startswith(magics):
            return kind
    if b"%PDF-" in head[:PDF_HEAD_BYTES]:
        return "pdf"
    if TEXT_DXF.match(head):
        return "dxf"
    is_xml = head.lstrip().startswith(b"<")
    return "svg" if is_xml and b"<svg" in data[:SVG_HEAD_BYTES] else None
