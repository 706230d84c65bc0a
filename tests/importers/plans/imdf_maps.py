"""A small IMDF map of two levels as other programs write it: rooms, doors, a lift, stairs, no walk lines."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

from app.importers.plans.frame import Frame

FRAME = Frame(8.5500, 47.3700)
GROUND, UPPER = "00000000-0000-4000-8000-000000000001", "00000000-0000-4000-8000-000000000002"


def positions(*points: tuple[float, float]) -> list[list[float]]:
    """Return longitudes and latitudes of points in metres."""
    return FRAME.geodetic_from_plan(points).tolist()


def box(x: float, y: float, width: float, height: float) -> dict[str, Any]:
    """Return a rectangle."""
    corners = (x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)
    return {"type": "Polygon", "coordinates": [positions(*corners)]}


def point(x: float, y: float) -> dict[str, Any]:
    """Return a point."""
    return {"type": "Point", "coordinates": positions((x, y))[0]}


def entry(kind: str, own: str, geometry: dict[str, Any] | None, **properties: object) -> dict[str, Any]:
    """Return a feature of the format."""
    return {
        "id": own,
        "type": "Feature",
        "feature_type": kind,
        "geometry": geometry,
        "properties": properties,
    }


def unit(
    own: str, level: str, category: str, geometry: dict[str, Any], name: str | None = None
) -> dict[str, Any]:
    """Return a unit."""
    labels = None if name is None else {"en": name, "de": f"{name} (de)"}
    return entry("unit", own, geometry, category=category, level_id=level, name=labels, restriction=None)


def opening(
    own: str, level: str, a: tuple[float, float], b: tuple[float, float], category: str
) -> dict[str, Any]:
    """Return a door from a to b."""
    line = {"type": "LineString", "coordinates": positions(a, b)}
    return entry("opening", own, line, category=category, level_id=level, name=None)


def levels() -> list[dict[str, Any]]:
    """Return the two levels."""
    labels = [("0", "Erdgeschoss", "Ground"), ("OG/1", "Obergeschoss", "Upper")]
    return [
        entry(
            "level",
            own,
            box(-1, -1, 27, 14),
            ordinal=ordinal,
            outdoor=False,
            category="unspecified",
            name={"de": german, "en": english},
            short_name={"de": short},
        )
        for own, ordinal, (short, german, english) in zip((GROUND, UPPER), (0, 1), labels, strict=True)
    ]


def features() -> dict[str, list[dict[str, Any]]]:
    """Return the features by type.

    On each level an L-shaped corridor 2 m wide runs 20 m east and then 10 m north. Rooms lie north of it.
    """
    corridor = (0, 0), (22, 0), (22, 12), (20, 12), (20, 2), (0, 2), (0, 0)
    bend = {"type": "Polygon", "coordinates": [positions(*corridor)]}
    units, openings = [], []
    for level, tag in ((GROUND, "g"), (UPPER, "u")):
        units += [
            unit(f"{tag}-corridor", level, "walkway", bend),
            unit(f"{tag}-office", level, "office", box(0, 2, 8, 6), f"Office {tag}"),
            unit(f"{tag}-store", level, "nonpublic", box(8, 2, 4, 6), f"Store {tag}"),
            unit(f"{tag}-stairs", level, "stairs", box(22, 0, 3, 5)),
            unit(f"{tag}-lift", level, "elevator", box(12, 2, 2, 2)),
            unit(f"{tag}-pillar", level, "column", box(10, 0.9, 0.3, 0.3)),
        ]
        openings += [
            opening(f"{tag}-door-1", level, (3.5, 2), (4.5, 2), "pedestrian"),
            opening(f"{tag}-door-2", level, (12.5, 2), (13.5, 2), "pedestrian"),
        ]
    openings.append(opening("front", GROUND, (20.5, 12), (21.5, 12), "pedestrian.principal"))
    return {
        "venue": [
            entry(
                "venue",
                "v",
                box(-1, -1, 27, 14),
                name={"de": "Haus"},
                display_point=point(0, 0),
                category="hotel",
            )
        ],
        "level": levels(),
        "unit": units,
        "opening": openings,
        "amenity": [
            entry(
                "amenity", "a", point(21, 8), category="vendingmachine", name=None, unit_ids=["u-corridor"]
            ),
            entry("amenity", "lost", point(21, 8), category="atm", name=None, unit_ids=["nowhere"]),
        ],
        "anchor": [entry("anchor", "an", point(2, 6), unit_id="g-office", address_id=None)],
        "occupant": [entry("occupant", "o", None, name={"de": "Praxis"}, category="doctor", anchor_id="an")],
        "kiosk": [
            entry("kiosk", "k", box(21, 10, 0.5, 0.5), name={"de": "Kiosk"}, level_id=GROUND, anchor_id=None)
        ],
        "fixture": [entry("fixture", f"f{k}", box(1, 5, 1, 1), level_id=GROUND) for k in range(3)],
        "detail": [entry("detail", "d", None, level_id=GROUND)],
        "relationship": [
            entry("relationship", "r", None, category="traversal", origin=None, destination=None)
        ],
    }


def write_imdf(target: Path, types: dict[str, list[dict[str, Any]]], manifest: object = None) -> Path:
    """Write an archive: a zip for a name that ends so, else a folder."""
    texts = {
        f"{kind}.geojson": json.dumps({"type": "FeatureCollection", "features": entries})
        for kind, entries in types.items()
    }
    texts["manifest.json"] = json.dumps(manifest or {"version": "1.0.0", "language": "de-CH"})
    if target.suffix == ".zip":
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in texts.items():
                archive.writestr(f"map/{name}", text)
        return target
    target.mkdir(parents=True)
    for name, text in texts.items():
        (target / name).write_text(text, encoding="utf-8")
    return target
