"""Outlines as other programs draw them, made valid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import shapely  # type: ignore[import-untyped]

from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeOptions:
    """Which parts of an outline are taken."""

    min_area_m2: float = limit(
        0.01,
        "A part of an outline that is smaller is left out.",
        chosen="By hand: what rounding leaves where an outline crosses itself; no area of a venue may be smaller.",
    )


OPTIONS = ShapeOptions()


def valid_parts(polygon: shapely.Geometry) -> Iterator[shapely.Polygon]:
    """Yield the valid polygons of an outline that may cross itself, without slivers."""
    mended = polygon if polygon.is_valid else shapely.make_valid(polygon)
    for part in shapely.get_parts(mended):
        for piece in shapely.get_parts(part):
            if isinstance(piece, shapely.Polygon) and piece.area >= OPTIONS.min_area_m2:
                yield piece
