"""The demonstration venue as the rest of the app knows it: floors with plans, features and heights."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from app.geometry.se3 import Array
from bench.recordings.cache import write_whole
from bench.venue.layout import FLOOR_HEIGHT_M
from bench.venue.plan_features import features
from bench.venue.plan_image import METERS_PER_PIXEL, origin_px, plan_from_world, plan_png

FLOOR_NAMES = ("Ground floor", "Upper floor")


@dataclass(frozen=True, slots=True)
class DemoVenue:
    """The venue's id, name, and the ids of its floors, lowest first."""

    id: str
    name: str
    floors: tuple[str, ...]


VENUE = DemoVenue("demo", "Meridian House (demonstration)", ("0", "1"))


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoFloor:
    """A floor: `plan_from_world` (4, 4), its range of world heights, its drawing and its GeoJSON features.

    `origin_px` is the pixel of plan (0, 0); u grows with plan x, v falls as plan y grows.
    """

    id: str
    name: str
    level: int
    z_min_m: float
    z_max_m: float
    plan_from_world: Array
    plan_png: bytes
    meters_per_pixel: float
    origin_px: tuple[float, float]
    features: dict[str, Any]

    def manifest(self) -> dict[str, Any]:
        """Return all but the drawing and the features, for a JSON file."""
        return {
            "id": self.id,
            "name": self.name,
            "level": self.level,
            "z_min_m": self.z_min_m,
            "z_max_m": self.z_max_m,
            "plan_from_world": self.plan_from_world.tolist(),
            "meters_per_pixel": self.meters_per_pixel,
            "origin_px": list(self.origin_px),
            "plan": f"floor_{self.id}.png",
            "features": f"floor_{self.id}.geojson",
        }


@lru_cache(maxsize=1)
def floor_plans() -> list[DemoFloor]:
    """Return the venue's floors, lowest first; the heights of the upper one begin at its ground."""
    return [_floor(level, floor_id) for level, floor_id in enumerate(VENUE.floors)]


def _floor(level: int, floor_id: str) -> DemoFloor:
    base = level * FLOOR_HEIGHT_M
    return DemoFloor(
        id=floor_id,
        name=FLOOR_NAMES[level],
        level=level,
        z_min_m=base - (0.5 if level == 0 else 0.0),
        z_max_m=base + FLOOR_HEIGHT_M,
        plan_from_world=plan_from_world(level).matrix,
        plan_png=plan_png(level),
        meters_per_pixel=METERS_PER_PIXEL,
        origin_px=origin_px(level),
        features=features(level),
    )


def write_floor_plans(directory: Path) -> Path:
    """Write each floor's PNG and GeoJSON and a `venue.json` that lists them; return that file."""
    directory.mkdir(parents=True, exist_ok=True)
    floors = floor_plans()
    for floor in floors:
        write_whole(directory / f"floor_{floor.id}.png", floor.plan_png)
        write_whole(directory / f"floor_{floor.id}.geojson", json.dumps(floor.features, indent=1).encode())
    manifest = {"id": VENUE.id, "name": VENUE.name, "floors": [floor.manifest() for floor in floors]}
    write_whole(directory / "venue.json", json.dumps(manifest, indent=1).encode())
    return directory / "venue.json"
