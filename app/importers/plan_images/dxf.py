"""The lines of a DXF drawing as a picture, by ezdxf: walls, doors and furniture as they are drawn, no texts."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator

import ezdxf
import ezdxf.path
import numpy as np
from ezdxf import disassemble, recover
from ezdxf.document import Drawing
from ezdxf.entities.dxfentity import DXFEntity
from ezdxf.lldxf.const import DXFError
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from app.errors import InvalidImageError, InvalidInputError
from app.importers.plan_images.order import OPTIONS, UNITS_M, Drawn, DrawOrder
from app.importers.plan_images.pictures import check_pixels

Points = NDArray[np.float64]
# The number of $INSUNITS, and metres.
DXF_UNITS_M = {1: 0.0254, 2: 0.3048, 4: 0.001, 5: 0.01, 6: 1.0, 7: 1000.0, 10: 0.9144, 14: 0.1}
MARGIN_PX = 10
LINE_PX = 2
# In drawing units. By hand: ten times the circumference of Earth in millimetres.
MAX_COORDINATE = 1e11
# What stands behind the end of files that old programs wrote.
_PADDING = b"\0\x1a \t\r\n"
DRAWN = frozenset(
    {"LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "SOLID", "TRACE", "3DFACE"}
)


def draw_dxf(data: bytes, order: DrawOrder) -> tuple[Image.Image, Drawn]:
    """Return the picture of a drawing's model space, y up; raises `InvalidImageError`, `InvalidInputError`."""
    if not data.rstrip(_PADDING).endswith(b"EOF"):
        # The library reads what there is of a drawing, and walls would be missing without notice.
        raise InvalidImageError("The DXF is cut short, it has no EOF at its end: copy or export it again.")
    try:
        document, _ = recover.read(io.BytesIO(data))
    except (DXFError, OSError, ValueError, IndexError, KeyError, AttributeError, TypeError) as error:
        raise InvalidImageError(f"The DXF can't be read: {str(error).rstrip('.')}.") from None
    meter = _unit_m(document, order)
    entities = list(_bounded(disassemble.recursive_decompose(document.modelspace())))
    coarse = [points * meter for points in _polylines(entities, 1.0 / meter)]
    if not coarse:
        raise InvalidImageError("The DXF has no line in its model space.")
    low, high = (
        np.min([p.min(axis=0) for p in coarse], axis=0),
        np.max([p.max(axis=0) for p in coarse], axis=0),
    )
    size_m = high - low
    scale_m = order.meters_per_pixel or max(float(size_m.max()) / OPTIONS.drawn_dxf_px, 1e-4)
    width, height = (math.ceil(side / scale_m) + 2 * MARGIN_PX for side in size_m)
    check_pixels(width, height, order.max_pixels, "give a larger meters_per_pixel")
    image = Image.new("L", (width, height), 255)
    pen = ImageDraw.Draw(image)
    for points in _polylines(entities, OPTIONS.dxf_curve_px * scale_m / meter):
        u = (points[:, 0] * meter - low[0]) / scale_m + MARGIN_PX
        v = height - 1 - MARGIN_PX - (points[:, 1] * meter - low[1]) / scale_m
        pen.line(np.column_stack([u, v]).ravel().tolist(), fill=0, width=LINE_PX)
    origin = float(MARGIN_PX - low[0] / scale_m), float(height - 1 - MARGIN_PX + low[1] / scale_m)
    return image, Drawn(width_px=width, height_px=height, meters_per_pixel=scale_m, origin_px=origin)


def _unit_m(document: Drawing, order: DrawOrder) -> float:
    """Return the metres of a drawing unit."""
    if order.units is not None:
        return UNITS_M[order.units]
    stated = DXF_UNITS_M.get(document.units)
    if stated is None:
        raise InvalidInputError(f"The DXF doesn't state its units; give units: one of {', '.join(UNITS_M)}.")
    return stated


def _bounded(entities: Iterable[DXFEntity]) -> Iterator[DXFEntity]:
    """Yield what can be drawn, with blocks taken apart, no more than the limit."""
    for count, entity in enumerate(entities):
        if count > OPTIONS.max_dxf_lines:
            raise InvalidImageError(_too_many())
        if entity.dxftype() in DRAWN:
            yield entity


def _polylines(entities: list[DXFEntity], tolerance: float) -> Iterator[Points]:
    """Yield each entity's line (n, 2) in drawing units, curves within the tolerance."""
    count = 0
    for entity in entities:
        try:
            path = ezdxf.path.make_path(entity)
            if not _is_drawable([tuple(p.xyz) for p in path.control_vertices()]):
                continue
            points = np.array([(p.x, p.y) for p in path.flattening(max(tolerance, 1e-9))])
        except (DXFError, ValueError, TypeError, ZeroDivisionError):
            continue
        if len(points) < 2 or not np.isfinite(points).all():
            continue
        count += len(points)
        if count > OPTIONS.max_dxf_lines:
            raise InvalidImageError(_too_many())
        yield points


def _is_drawable(points: list[tuple[float, float, float]]) -> bool:
    """Whether the points (n, 3) that a line is made of are numbers: a curve of others would be divided without end.

    Raises `InvalidImageError` for coordinates that no building has.
    """
    largest = float(np.abs(points).max()) if points else 0.0
    if np.isfinite(largest) and largest > MAX_COORDINATE:
        raise InvalidImageError(f"The DXF has a coordinate of {largest:.3g}: it is damaged, export it again.")
    return bool(np.isfinite(largest))


def _too_many() -> str:
    return f"The DXF has more than {OPTIONS.max_dxf_lines:,} lines; send the storey's walls alone."
