"""A page with an ArUco marker to print."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from app.engine.mapping.structure.markers import DICTIONARY

DPI = 300
MM_PER_INCH = 25.4
A4_MM = (210.0, 297.0)
SMALLEST_MM = 20.0
# The white border that the detector needs, and printers' margins, must fit on the page.
LARGEST_MM = 170.0
MAX_NUMBER = 49
TEXT_MM = 4.0
MARGIN_MM = 15.0


def write_marker_page(path: Path, side_mm: float, number: int) -> None:
    """Write a PDF, one page of A4, with a marker whose black square has a side of `side_mm`, and what it is."""
    width, height = (_px(length) for length in A4_MM)
    side = _px(side_mm)
    page = np.full((height, width), 255, np.uint8)
    left, top = (width - side) // 2, (height - side) // 2
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    page[top : top + side, left : left + side] = cv2.aruco.generateImageMarker(dictionary, number, side)
    image = Image.fromarray(page)
    text = f"Roomfix marker {number}: the side of the black square is {side_mm:g} mm. Print at 100 %, then measure it."
    font = ImageFont.load_default(_px(TEXT_MM))
    ImageDraw.Draw(image).text((_px(MARGIN_MM), height - _px(MARGIN_MM)), text, fill=0, font=font)
    image.save(path, format="PDF", resolution=DPI)


def _px(length_mm: float) -> int:
    return round(length_mm / MM_PER_INCH * DPI)
