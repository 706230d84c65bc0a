"""A floor's plan as SVG: its image, areas, links, landmarks, and a route over it."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.floor import Floor, PlanImage
from app.engine.floors.model import FloorFeatures
from app.engine.navigation.model import Route
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawingOptions:
    """How much of the plan a drawing shows."""

    margin_m: float = limit(
        1.0, "Margin around what is drawn.", chosen="By hand: room for the names and circles at the edge."
    )
    empty_m: float = limit(
        10.0,
        "Side of the square that is shown of a plan with nothing on it.",
        chosen="By hand: a large room.",
    )


OPTIONS = DrawingOptions()
STYLE = """
.area { fill: #4a7bd0; fill-opacity: 0.10; stroke: #4a7bd0; stroke-width: 0.05 }
.link { fill: none; stroke: #777; stroke-width: 0.06; stroke-dasharray: 0.3 0.2 }
.way { stroke: #b060c0; stroke-dasharray: none }
.landmark { fill: #1b1b1b } .poi { fill: #c47a00 }
.route { fill: none; stroke: #d02b2b; stroke-width: 0.25; stroke-linejoin: round; stroke-linecap: round }
.start { fill: #1d8a3c } .end { fill: #d02b2b }
text { font: 0.5px sans-serif; fill: #1b1b1b } .name { text-anchor: middle; fill: #2a4f94 }
"""


def draw_plan(
    floor: Floor, features: FloorFeatures, image: bytes | None = None, route: Route | None = None
) -> str:
    """Return an SVG of a floor's features in plan metres, over its plan `image` if that is given.

    With `route`, the parts of it on this floor are drawn too. SVG's y axis points down, so y is negated.
    """
    x0, y0, x1, y1 = _bounds(floor, features, image)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x0:.2f} {-y1:.2f} {x1 - x0:.2f} {y1 - y0:.2f}">',
        f"<title>{escape(floor.name)}</title><style>{STYLE}</style>",
        *_image(floor.plan, image),
        *_areas(features),
        # A plan image has the names of rooms on it.
        *([] if image is not None else _names(features)),
        *_links(features),
        *([] if route is None else _route(route, floor.id)),
        *_points(features),
        "</svg>",
    ]
    return "\n".join(parts)


def _bounds(floor: Floor, features: FloorFeatures, image: bytes | None) -> tuple[float, float, float, float]:
    corners = [np.array(area.polygon.bounds).reshape(2, 2) for area in features.areas]
    corners += [link.points for link in features.links]
    corners += [
        np.array([[mark.x, mark.y]])
        for group in (features.landmarks, features.pois)
        for mark in group.values()
    ]
    if floor.plan is not None and image is not None:
        corners.append(_image_box(floor.plan))
    if not corners:
        return 0.0, 0.0, OPTIONS.empty_m, OPTIONS.empty_m
    points = np.vstack(corners)
    x0, y0 = points.min(axis=0) - OPTIONS.margin_m
    x1, y1 = points.max(axis=0) + OPTIONS.margin_m
    return float(x0), float(y0), float(x1), float(y1)


def _image_box(plan: PlanImage) -> NDArray[np.float64]:
    """Return the lower left and upper right corner of the plan image in plan metres."""
    u, v = plan.origin_px
    scale = plan.meters_per_pixel
    left, top = (-0.5 - u) * scale, (v + 0.5) * scale
    return np.array([[left, top - plan.height_px * scale], [left + plan.width_px * scale, top]])


def _image(plan: PlanImage | None, image: bytes | None) -> Iterator[str]:
    if plan is None or image is None:
        return
    (x0, y0), (x1, y1) = _image_box(plan)
    data = base64.b64encode(image).decode()
    yield (
        f'<image x="{x0:.3f}" y="{-y1:.3f}" width="{x1 - x0:.3f}" height="{y1 - y0:.3f}" '
        f'preserveAspectRatio="none" href="data:{plan.media_type};base64,{data}"/>'
    )


def _areas(features: FloorFeatures) -> Iterator[str]:
    for area in features.areas:
        rings = [area.polygon.exterior, *area.polygon.interiors]
        path = " ".join(f"M{_coordinates(shapely.get_coordinates(ring))}Z" for ring in rings)
        yield (
            f'<path class="area" fill-rule="evenodd" id={quoteattr(f"area:{area.id}")} d="{path}">'
            f"<title>{escape(area.name)}</title></path>"
        )


def _names(features: FloorFeatures) -> Iterator[str]:
    for area in features.areas:
        middle = area.polygon.representative_point()
        yield f'<text class="name" x="{middle.x:.2f}" y="{-middle.y:.2f}">{escape(area.name)}</text>'


def _links(features: FloorFeatures) -> Iterator[str]:
    for link in features.links:
        kind = "link" if link.to_floor is None else "link way"
        yield f'<polyline class="{kind}" points="{_coordinates(link.points)}"/>'


def _points(features: FloorFeatures) -> Iterator[str]:
    for kind, group in (("landmark", features.landmarks), ("poi", features.pois)):
        for mark in group.values():
            yield (
                f'<circle class="{kind}" cx="{mark.x:.2f}" cy="{-mark.y:.2f}" r="0.15">'
                f"<title>{escape(mark.name)}</title></circle>"
            )


def _route(route: Route, floor_id: str) -> Iterator[str]:
    line: list[tuple[float, float]] = []
    for a, b in pairwise(route.points):
        if a.floor == floor_id and not line:
            line.append((a.x, a.y))
        if a.floor == b.floor == floor_id:
            line.append((b.x, b.y))
        elif line:
            yield f'<polyline class="route" points="{_coordinates(np.array(line))}"/>'
            line = []
    if line:
        yield f'<polyline class="route" points="{_coordinates(np.array(line))}"/>'
    for kind, point in (("start", route.points[0]), ("end", route.points[-1])):
        if point.floor == floor_id:
            yield f'<circle class="{kind}" cx="{point.x:.2f}" cy="{-point.y:.2f}" r="0.35"/>'


def _coordinates(points: NDArray[np.float64]) -> str:
    return " ".join(f"{x:.3f},{-y:.3f}" for x, y in points)
