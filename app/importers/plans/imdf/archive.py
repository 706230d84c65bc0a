"""The features of an IMDF archive by type, with their labels and geometries."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

from app.errors import InvalidInputError
from app.importers.plans.files import PlanFiles, json_object
from app.importers.plans.frame import Frame
from app.importers.plans.imdf.names import EXTENSION, FEATURE_TYPES, OWN
from app.importers.plans.model import Points
from app.importers.plans.shapes import valid_parts
from app.limits import limit

GeoJson = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImdfOptions:
    """Which features are taken."""

    max_ordinal: int = limit(
        100, "Largest absolute ordinal of a level.", chosen="By hand: the lowest level that a floor may have."
    )


OPTIONS = ImdfOptions()


class ImdfArchive:
    """Features by type and by id; raises `InvalidInputError` for files that are no IMDF."""

    def __init__(self, files: PlanFiles) -> None:
        manifest = files.json("manifest.json") if "manifest.json" in files.contents else {}
        extensions = manifest.get("extensions")
        self.is_own = isinstance(extensions, list) and EXTENSION in extensions
        self._language = str(manifest.get("language") or "en")
        self._types: dict[str, list[GeoJson]] = {}
        for name, data in sorted(files.contents.items()):
            if name != "manifest.json":
                for one in _features(name, data):
                    kind = one.get("feature_type") or name.split(".")[0]
                    self._types.setdefault(str(kind), []).append(one)
        self.by_id = {str(one.get("id")): one for group in self._types.values() for one in group}

    def of_type(self, kind: str) -> list[GeoJson]:
        """Return the features of a type."""
        return self._types.get(kind, [])

    @property
    def counts(self) -> dict[str, int]:
        """How many features there are of each type."""
        return {kind: len(group) for kind, group in self._types.items()}

    def label(self, labels: object) -> str | None:
        """Return the text of labels by language: in the archive's, else in English, else the first."""
        if not isinstance(labels, Mapping):
            return None
        texts = {str(key): value.strip() for key, value in labels.items() if isinstance(value, str)}
        wanted = (self._language, self._language.split("-")[0], "en", *texts)
        text = next((texts[key] for key in wanted if texts.get(key)), None)
        return None if text is None else " ".join(text.split())[:200]

    def own(self, one: GeoJson) -> Mapping[str, Any]:
        """Return what Roomfix wrote beside the format's members; empty for archives of other programs."""
        value = properties_of(one).get(OWN) if self.is_own else None
        return value if isinstance(value, Mapping) else {}


def _features(name: str, data: bytes) -> list[GeoJson]:
    value = json_object(name, data)
    entries = value.get("features")
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise InvalidInputError(f"{name} must be a GeoJSON FeatureCollection.")
    return entries


def properties_of(one: GeoJson) -> Mapping[str, Any]:
    """Return a feature's properties, empty where it has none."""
    value = one.get("properties")
    return value if isinstance(value, Mapping) else {}


def reference(value: object) -> str | None:
    """Return the id in a FEATURE-REFERENCE."""
    return str(value["id"]) if isinstance(value, Mapping) and "id" in value else None


def is_imdf(files: PlanFiles) -> bool:
    """Whether the files look like an IMDF archive: a manifest or levels, and files named after feature types."""
    stems = {name.split(".")[0] for name in files.contents}
    return "level" in stems and ("manifest" in stems or len(stems & {*FEATURE_TYPES}) > 1)


def plan_points(coordinates: object, frame: Frame, what: str) -> Points:
    """Return plan metres (n, 2) of a list of positions; raises `InvalidInputError` that names the feature."""
    try:
        positions = [[float(position[0]), float(position[1])] for position in coordinates]  # type: ignore[attr-defined]
    except (TypeError, ValueError, IndexError, KeyError):
        raise InvalidInputError(f"{what} has no valid coordinates.") from None
    if not all(math.isfinite(number) for position in positions for number in position):
        raise InvalidInputError(f"{what} has coordinates that are not finite.")
    return frame.plan_from_geodetic(np.array(positions, dtype=np.float64).reshape(-1, 2))


def polygons_of(geometry: object, frame: Frame, what: str) -> Iterator[shapely.Polygon]:
    """Yield the parts of a Polygon or MultiPolygon in plan metres, mended where an outline crosses itself."""
    if not isinstance(geometry, Mapping) or geometry.get("type") not in ("Polygon", "MultiPolygon"):
        raise InvalidInputError(f"{what} needs a Polygon.")
    parts = geometry.get("coordinates")
    for rings in [parts] if geometry["type"] == "Polygon" else parts or []:
        if not isinstance(rings, list) or not rings:
            raise InvalidInputError(f"{what} has no valid coordinates.")
        rows = [plan_points(ring, frame, what) for ring in rings]
        if len(np.unique(rows[0], axis=0)) < 3:
            raise InvalidInputError(f"{what} has an outline of fewer than three points.")
        polygon = shapely.Polygon(rows[0], [row for row in rows[1:] if len(np.unique(row, axis=0)) >= 3])
        yield from valid_parts(polygon)
