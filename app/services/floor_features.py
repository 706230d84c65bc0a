"""The features of floors: checked and stored, and kept in memory until they change."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from app.engine.floors.collection import parse_features, parse_json, read_collection
from app.engine.floors.floor import Floor
from app.engine.floors.model import Area, FloorFeatures
from app.engine.floors.places import PlaceIndex, areas_named
from app.engine.floors.plan_point import PlanPoint
from app.engine.floors.reading import GeoJson
from app.engine.floors.sentences import listed, short
from app.engine.floors.walls import FloorWalls
from app.engine.navigation.network import check_walkable
from app.engine.tracking.plan_walk.plans import Plans
from app.errors import NotFoundError
from app.limits import limit
from app.lru import LruCache
from app.services.resources import Resources
from app.storage.db import Database
from app.storage.floors import get_features, get_floor, list_floors, set_features


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureCacheOptions:
    """How many floors' features stay in memory."""

    floors: int = limit(
        256,
        "Floors whose features are kept in memory, those used last.",
        chosen="By hand: more floors than most servers have, at a few megabytes for a large one.",
    )
    plans: int = limit(
        16,
        "Venues whose walls are kept in memory, those used last.",
        chosen="By hand: a megabyte for a floor of 100 m, and made again in a tenth of a second.",
    )
    walls: int = limit(
        64,
        "Floors whose walls are kept in memory for monitoring cameras, those used last.",
        chosen="By hand: the floors of as many venues as `plans`, four each.",
    )


OPTIONS = FeatureCacheOptions()


def store_features(
    resources: Resources, venue_id: str, floor_id: str, collection: bytes | GeoJson
) -> FloorFeatures:
    """Check a floor's features and store them in place of the ones before.

    Raises `InvalidInputError` that names the feature, and `NotFoundError`.
    """
    value = parse_json(collection) if isinstance(collection, bytes) else collection
    with resources.database.read() as connection:
        floor = get_floor(connection, venue_id, floor_id)
        floors = list_floors(connection, venue_id)
    stored, features = parse_features(value, floor_id, [one.id for one in floors], floor.plan)
    check_walkable(features)
    with resources.database.write() as connection:
        set_features(connection, venue_id, floor_id, stored)
    return features


def stored_features(resources: Resources, venue_id: str, floor_id: str) -> GeoJson:
    """Return a floor's features as GeoJSON, an empty collection when it has none; raises `NotFoundError`."""
    with resources.database.read() as connection:
        return get_features(connection, venue_id, floor_id).collection


class FeatureLibrary:
    """Gives the features of floors, read again only when they have changed. Safe to share between threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._indexes: LruCache[tuple[str, str, str], PlaceIndex] = LruCache(OPTIONS.floors)
        self._plans: LruCache[tuple[object, ...], Plans] = LruCache(OPTIONS.plans)
        self._walls: LruCache[tuple[object, ...], tuple[FloorWalls | None]] = LruCache(OPTIONS.walls)

    def index(self, floor: Floor) -> PlaceIndex:
        """Return the areas and landmarks of a floor; an empty index for a floor without features."""
        digest = floor.features_sha256
        if digest is None:
            return PlaceIndex(FloorFeatures())
        kept = self._indexes.get((floor.venue_id, floor.id, digest))
        if kept is not None:
            return kept
        with self._database.read() as connection:
            stored = get_features(connection, floor.venue_id, floor.id)
        index = PlaceIndex(read_collection(stored.collection, floor.id)[1])
        # Under the digest of what was read: the features may have changed after the floor was read.
        self._indexes.put((floor.venue_id, floor.id, stored.sha256 or ""), index)
        return index

    def features(self, floor: Floor) -> FloorFeatures:
        """Return the features of a floor."""
        return self.index(floor).features

    def plans(self, floors: Sequence[Floor]) -> Plans:
        """Return the plans of a venue's floors for a tracker that goes by them."""
        key = tuple(_shape(floor) for floor in floors)
        return self._plans.get_or_make(
            key, lambda: Plans.of(floors, {floor.id: self.features(floor) for floor in floors})
        )

    def walls(self, floor: Floor) -> FloorWalls | None:
        """Return the walls of a floor in metres of its plan, None where it has no areas."""
        if floor.features_sha256 is None:
            return None
        (walls,) = self._walls.get_or_make(
            _shape(floor), lambda: (FloorWalls.of(self.features(floor), lambda points: points),)
        )
        return walls

    def described(self, plan: PlanPoint, floor: Floor) -> PlanPoint:
        """Return a plan point with its area and nearest landmark."""
        index = self.index(floor)
        area = index.area(plan.x, plan.y)
        nearest = index.nearest_landmark(plan.x, plan.y)
        return dataclasses.replace(
            plan,
            area=None if area is None else area.id,
            area_name=None if area is None else area.name,
            nearest_landmark=None if nearest is None else nearest.landmark.id,
            nearest_landmark_name=None if nearest is None else nearest.landmark.name,
            nearest_landmark_m=None if nearest is None else nearest.distance_m,
        )

    def areas(self, floors: Sequence[Floor], text: str) -> list[tuple[Floor, Area]]:
        """Return the areas of an id or name on these floors; raises `NotFoundError` when there is none."""
        found = [(floor, area) for floor in floors for area in areas_named(self.features(floor), text)]
        if not found:
            known = sorted({area.id for floor in floors for area in self.features(floor).areas})
            raise NotFoundError(f"There is no area {short(text)} on these floors; there are {listed(known)}.")
        return found


def _shape(floor: Floor) -> tuple[object, ...]:
    """Return what a floor's walls and heights are made from."""
    plan = None if floor.plan_from_world is None else floor.plan_from_world.tobytes()
    return (floor.venue_id, floor.id, floor.z_min_m, floor.z_max_m, plan, floor.features_sha256)
