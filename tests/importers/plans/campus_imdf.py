"""A campus as a university's own tool writes IMDF: no manifest, labels in one language that isn't English, levels of
two buildings with one ordinal and none between 0 and 2, a MultiPolygon as a level, repeated points, walls that meet to
a tenth of a millimetre only, unnamed corridors, and feature types of its own in files of their own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from app.importers.plans.frame import Frame
from tests.importers.plans.imdf_maps import entry

Types = dict[str, list[dict[str, Any]]]
# Walls that run along no axis.
FRAME = Frame(30.3726, 60.0074, 23.0)
MAIN, TOWER = "b529e845-0000-4000-8000-000000000001", "f8ce7575-0000-4000-8000-000000000002"
LEVELS = (("main-1", MAIN, 0, "1"), ("main-3", MAIN, 2, "3"), ("tower-1", TOWER, 0, "1"))
# Of the tower from the main building, in metres.
TOWER_X_M = 90.0


def positions(*points: tuple[float, float]) -> list[list[float]]:
    """Return longitudes and latitudes of points in metres, with fifteen digits as the tool has them."""
    return FRAME.geodetic_from_plan(points).tolist()


def ring(x: float, y: float, width: float, height: float, repeated: bool = False) -> list[list[float]]:
    """Return a rectangle's outline; with its second corner twice where that is wished."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
    return positions(*corners[:2], *corners[1:]) if repeated else positions(*corners)


def box(x: float, y: float, width: float, height: float, repeated: bool = False) -> dict[str, Any]:
    """Return a rectangle."""
    return {"type": "Polygon", "coordinates": [ring(x, y, width, height, repeated)]}


def point(x: float, y: float) -> dict[str, Any]:
    """Return a point."""
    return {"type": "Point", "coordinates": positions((x, y))[0]}


def named(name: str | None, short: str | None = None) -> dict[str, Any]:
    """Return a feature's labels."""
    return {
        "name": None if name is None else {"ru": name},
        "alt_name": None if name is None else {"ru": short or name},
    }


def campus() -> Types:
    """Return the features by file."""
    types: Types = {"unit": [], "opening": [], "amenity": []}
    types["venue"] = [
        entry(
            "venue",
            "v",
            box(-20, -20, 160, 60),
            **named("Политехнический университет"),
            category="university",
        )
    ]
    types["building"] = [
        entry("building", own, None, **named(None), category="unspecified") for own in (MAIN, TOWER)
    ]
    types["footprint"] = [
        entry(
            "footprint", f"footprint-{kind}", box(0, 0, 40, 12), category=kind, name=None, building_ids=[MAIN]
        )
        for kind in ("ground", "aerial", "subterranean")
    ]
    types["level"] = [_level(*level) for level in LEVELS]
    for level, _, _, floor in LEVELS[:2]:
        _add_wing(types, level, floor)
    _add_room(types, "tower-1", "hall", (TOWER_X_M, 0, 10, 10), "lobby", "Вестибюль")
    types["detail"] = [_steps()]
    types["attraction"] = [
        entry(
            "attraction",
            "at",
            point(TOWER_X_M, 0),
            **named("Гидробашня", "Г"),
            image="Gydro",
            building_id=TOWER,
        )
    ]
    types["enviroment"] = [entry("enviroment.area", "grass", box(50, 0, 10, 10), category="grass")]
    types["enviromentAmenity"] = [entry("enviroment.amenity", "gate", point(-10, 0), **named("КПП"))]
    return types


def _level(own: str, building: str, ordinal: int, short: str) -> dict[str, Any]:
    outline = box(TOWER_X_M, 0, 10, 10)
    if building == MAIN:
        parts = [[ring(0, 0, 40, 12, repeated=True)], [ring(44, 0, 4, 4)]]
        outline = {"type": "MultiPolygon", "coordinates": parts}
    return entry(
        "level", own, outline, name={"ru": f"Этаж {short}"}, short_name={"ru": short}, ordinal=ordinal, outdoor=False,
        address_id=None, building_ids=[building], category="arrivals", restriction="employeesonly",
    )  # fmt: skip


def _add_wing(types: Types, level: str, floor: str) -> None:
    """Add a corridor 40 m long with two classrooms, a lecture hall, a restroom and stairs along it."""
    rooms = [
        ("stairs", (0, 3, 5, 9), "stairs", "Лестница"),
        ("wc", (5, 3, 5, 9), "restroom.female", "Туалет женский"),
        ("a", (10, 3, 10, 9), "classroom", f"Кабинет {floor}01"),
        ("b", (20, 3, 10, 9), "classroom", f"Кабинет {floor}02"),
        ("hall", (30, 3, 10, 9), "auditorium", f"Лекторий {floor}05"),
    ]
    _add_room(types, level, "corridor", (0, 0, 40, 3), "walkway", None)
    for tag, place, category, name in rooms:
        _add_room(types, level, tag, place, category, name)
        x = place[0] + 2.0
        door = {"type": "LineString", "coordinates": positions((x, 3), (x + 1, 3))}
        properties = {
            "category": "automobile" if category == "stairs" else "pedestrian",
            "unit_categoty": category,
            "door": {"type": "open", "material": "metal", "automatic": False},
            "level_id": level,
        }
        types["opening"].append(entry("opening", f"{level}-{tag}-door", door, **properties, **named(None)))
        if category in ("stairs", "restroom.female"):
            at = point(place[0] + 2.5, 8)
            amenity = entry(
                "amenity",
                f"{level}-{tag}-amenity",
                at,
                category=category,
                unit_ids=[f"{level}-{tag}"],
                **named(name),
            )
            types["amenity"].append(amenity)


def _add_room(
    types: Types,
    level: str,
    tag: str,
    place: tuple[float, float, float, float],
    category: str,
    name: str | None,
) -> None:
    # A tenth of a millimetre is what the tool's rounding leaves between neighbours.
    x, y, width, height = np.array(place) + 1e-4 * np.array([len(types["unit"]) % 3 - 1, 0, 0, 0])
    outline = box(x, y, width, height, repeated=tag == "hall")
    restriction = "employeesonly" if category == "nonpublic" else None
    types["unit"].append(
        entry(
            "unit",
            f"{level}-{tag}",
            outline,
            category=category,
            level_id=level,
            restriction=restriction,
            accessibility=None,
            display_point=point(x + width / 2, y + height / 2),
            **named(name),
        )
    )


def _steps() -> dict[str, Any]:
    lines = [positions((-4, 0.3 * step), (-1, 0.3 * step)) for step in range(4)]
    return entry(
        "detail", "steps", {"type": "MultiLineString", "coordinates": lines}, category="steps", level_id=None
    )
