"""`roomfix marker`: a marker of known size to print, which gives a map of a video or of photos its scale."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.commands.console import console
from app.engine.mapping.structure.marker_page import LARGEST_MM, MAX_NUMBER, SMALLEST_MM, write_marker_page


def marker(
    output: Annotated[Path, typer.Option(help="The PDF to write.")] = Path("marker.pdf"),
    side_mm: Annotated[
        float, typer.Option(min=SMALLEST_MM, max=LARGEST_MM, help="Side of the black square.")
    ] = 160.0,
    number: Annotated[int, typer.Option(min=0, max=MAX_NUMBER, help="Which of the 50 markers.")] = 0,
) -> None:
    """Write a page (A4) with a marker; print it at its actual size, lay it flat, and measure its side."""
    write_marker_page(output, side_mm, number)
    console.print(
        f'{output}: print it at 100 %, measure the side of the black square, and build with "scale": '
        f'{{"marker_m": {side_mm / 1000:g}}}.',
        soft_wrap=True,
    )
