"""Venues that are exported and imported, and what must be the same afterwards."""

from __future__ import annotations

from itertools import combinations, islice
from pathlib import Path
from typing import Any

import numpy as np

from app.engine.navigation.model import Route
from app.errors import NoRouteError, OffNetworkError
from app.importers.plans.frame import Frame
from app.importers.plans.registry import read_indoor_map
from app.services.floor_features import FeatureLibrary, stored_features
from app.services.plans.export_plan import ImdfDetails, export_imdf
from app.services.plans.import_plan import import_indoor_map
from app.services.resources import Resources
from app.services.routes import RouteService
from app.storage.floors import list_floors

SOMEWHERE = Frame(13.4049, 52.52, 25.0)


def round_trip(resources: Resources, venue: str, folder: Path, again: str) -> Path:
    """Export a venue and import it under another id; returns the archive."""
    archive = folder / "venue.imdf.zip"
    export_imdf(resources, venue, SOMEWHERE, archive, ImdfDetails())
    import_indoor_map(resources, again, read_indoor_map(archive))
    return archive


def floors_of(resources: Resources, venue: str) -> list[tuple[Any, ...]]:
    """Return what a floor is, without its plan image."""
    with resources.database.read() as connection:
        floors = list_floors(connection, venue)
    return [
        (
            floor.id,
            floor.name,
            floor.level,
            floor.z_min_m,
            floor.z_max_m,
            None if floor.plan_from_world is None else floor.plan_from_world.round(9).tolist(),
        )
        for floor in floors
    ]


def features_of(resources: Resources, venue: str, floor: str) -> dict[tuple[str, str], dict[str, Any]]:
    """Return a floor's features by kind and id."""
    stored = stored_features(resources, venue, floor)["features"]
    return {(one["properties"]["kind"], one["id"]): one for one in stored}


def assert_same_features(resources: Resources, venue: str, again: str) -> int:
    """Check that all properties are equal and all coordinates within a millimetre; returns how many there are."""
    count = 0
    assert floors_of(resources, venue) == floors_of(resources, again)
    for floor_id, *_ in floors_of(resources, venue):
        one, other = (features_of(resources, name, floor_id) for name in (venue, again))
        assert one.keys() == other.keys()
        for key, feature in one.items():
            assert feature["properties"] == other[key]["properties"]
            assert feature["geometry"]["type"] == other[key]["geometry"]["type"]
            shapes = [shape_of(entry["geometry"]["coordinates"]) for entry in (feature, other[key])]
            assert np.abs(shapes[0] - shapes[1]).max() < 1e-3
            count += 1
    return count


def shape_of(coordinates: Any) -> np.ndarray:
    """Return the coordinates of a geometry; of a polygon without holes from its lowest corner on, counter-clockwise."""
    points = np.array(coordinates, dtype=float)
    if points.ndim < 3:
        return points
    ring = points[0, :-1]
    after = np.roll(ring, -1, axis=0)
    if (ring[:, 0] * after[:, 1] - ring[:, 1] * after[:, 0]).sum() < 0:
        ring = ring[::-1]
    return np.roll(ring, -int(np.lexsort(np.round(ring, 2).T)[0]), axis=0)


def all_routes(resources: Resources, venue: str, every: int) -> dict[tuple[str, str], Route | None]:
    """Return the route of every n-th pair of landmarks, None where there is none."""
    service = RouteService(resources.database, FeatureLibrary(resources.database))
    network = service.network(venue)
    names = [
        f"{floor_id}:{mark}"
        for floor_id, part in network.parts.items()
        for mark in part.places.features.landmarks
    ]
    found: dict[tuple[str, str], Route | None] = {}
    for a, b in islice(combinations(sorted(names), 2), 0, None, every):
        try:
            found[a, b] = service.route(venue, a, b)
        except (NoRouteError, OffNetworkError):
            found[a, b] = None
    return found


def assert_same_routes(resources: Resources, venue: str, again: str, every: int = 1) -> int:
    """Check that every n-th pair of landmarks has the same route, its length within a centimetre; returns how many."""
    ours, theirs = all_routes(resources, venue, every), all_routes(resources, again, every)
    assert ours.keys() == theirs.keys()
    for pair, route in ours.items():
        other = theirs[pair]
        assert (route is None) == (other is None)
        if route is not None and other is not None:
            assert abs(route.distance_m - other.distance_m) < 0.01
            assert route.modes == other.modes
            assert [step.turn for step in route.steps] == [step.turn for step in other.steps]
            assert [one.landmark.id for one in route.passages] == [one.landmark.id for one in other.passages]
    return sum(route is not None for route in ours.values())
