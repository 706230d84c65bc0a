"""A venue's floors and features as an IMDF archive that reads back the same."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.floors.earth import Earth
from app.engine.floors.floor import Floor
from app.errors import InvalidInputError
from app.importers.plans.frame import Frame, frame_from_json
from app.importers.plans.imdf.names import EXTENSION, VERSION
from app.services.plans.imdf_features import ImdfWriter, PlacedFloor
from app.services.resources import Resources
from app.storage.floors import get_features, list_floors
from app.storage.venues import earth_of, get_venue

# An archive holds each of these files, empty where there is nothing of its type.
FILES = ("address", "venue", "building", "footprint", "level", "unit", "amenity", "opening", "relationship")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImdfDetails:
    """What the format wants to know and a venue doesn't hold."""

    category: str = "businesscampus"
    address: str = "unknown"
    locality: str = "unknown"
    country: str = "ZZ"
    language: str = "en"


def export_imdf(
    resources: Resources, venue_id: str, frame: Frame | None, output: Path, details: ImdfDetails
) -> dict[str, int]:
    """Write the archive and return how many features of each type it holds.

    `frame` is where (0, 0) of the lowest floor's plan lies, None for the venue's own origin; other floors lie above it
    by their `plan_from_world`, or at the same plan coordinates where that is not known. Raises `NotFoundError`, and
    `InvalidInputError` for a venue that has no origin either.
    """
    with resources.database.read() as connection:
        venue = get_venue(connection, venue_id)
        floors = list_floors(connection, venue_id)
        earth = earth_of(connection, venue_id, floors)
        collections = [get_features(connection, venue_id, floor.id).collection for floor in floors]
    if not floors:
        raise InvalidInputError(f"Venue {venue_id!r} has no floor to export.")
    if len({floor.level for floor in floors}) != len(floors):
        raise InvalidInputError("Two floors have the same level; IMDF tells floors apart by it.")
    lowest_frame = frame or _own_frame(earth, floors[0])
    placed = [
        PlacedFloor(floor, _frame_of(floor, floors[0], lowest_frame), collection)
        for floor, collection in zip(floors, collections, strict=True)
    ]
    types = ImdfWriter(venue_id, venue.name, details.language).write(
        placed, _address(details), details.category
    )
    _write_zip(output, types, details.language)
    return {kind: len(types[kind]) for kind in FILES}


def _own_frame(earth: Earth | None, lowest: Floor) -> Frame:
    """Return the frame of the lowest floor's plan by the venue's origin; raises `InvalidInputError`."""
    frame = None if earth is None else frame_from_json(earth.plan_origin(lowest))
    if frame is None:
        raise InvalidInputError(
            "The venue has no place on Earth: give --origin longitude,latitude[,rotation_deg], or set its origin."
        )
    return frame


def _frame_of(floor: Floor, lowest: Floor, frame: Frame) -> Frame:
    """Return the frame of a floor's plan, turned and moved as its plan lies above the lowest floor's.

    A plan of another scale keeps its own metres: it lies right at the plan's (0, 0) alone.
    """
    if floor is lowest or floor.plan_from_world is None or lowest.plan_from_world is None:
        return frame
    own_from_lowest = floor.plan_from_world @ np.linalg.inv(lowest.plan_from_world)
    turn_deg = float(np.degrees(np.arctan2(own_from_lowest[1, 0], own_from_lowest[0, 0])))
    x, y = np.round(own_from_lowest[:2, 3], 6)
    return Frame(frame.longitude, frame.latitude, frame.rotation_deg + turn_deg, (float(x), float(y)))


def _address(details: ImdfDetails) -> dict[str, Any]:
    return {
        "address": details.address,
        "unit": None,
        "locality": details.locality,
        "province": None,
        "country": details.country,
        "postal_code": None,
        "postal_code_ext": None,
        "postal_code_vanity": None,
    }


def _write_zip(output: Path, types: dict[str, list[dict[str, Any]]], language: str) -> None:
    """Write the archive beside its place, and put it there when it is whole."""
    manifest = {
        "version": VERSION,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "generated_by": "Roomfix",
        "language": language,
        "extensions": [EXTENSION],
    }
    partial = output.with_name(f".{output.name}.partial")
    try:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("manifest.json", json.dumps(manifest, indent=1))
            for kind in FILES:
                collection = {"type": "FeatureCollection", "name": kind, "features": types[kind]}
                archive.writestr(f"{kind}.geojson", json.dumps(collection, ensure_ascii=False))
        partial.replace(output)
    finally:
        partial.unlink(missing_ok=True)
