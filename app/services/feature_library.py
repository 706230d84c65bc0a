"""The features of floors in memory, read again only when they have changed."""

from __future__ import annotations

import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Sequence

from app.engine.floors.checks import listed
from app.engine.floors.collection import read_collection
from app.engine.floors.floor import Floor
from app.engine.floors.geometry import short
from app.engine.floors.model import Area, FloorFeatures
from app.engine.floors.places import PlaceIndex, areas_named
from app.engine.floors.plan_point import PlanPoint
from app.errors import NotFoundError
from app.storage.db import Database
from app.storage.floors import get_features

MAX_FLOORS = 256


class FeatureLibrary:
    """Holds what was made of floors' features, by their digest. Safe to share between threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, str, str], PlaceIndex] = OrderedDict()

    def index(self, floor: Floor) -> PlaceIndex:
        """Return the places of a floor; none for a floor without features."""
        if floor.features_sha256 is None:
            return PlaceIndex(FloorFeatures())
        key = floor.venue_id, floor.id, floor.features_sha256
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        with self._database.read() as connection:
            stored = get_features(connection, floor.venue_id, floor.id)
        index = PlaceIndex(read_collection(stored.collection, floor.id)[1])
        with self._lock:
            # By the digest of what was read: it may have changed since the floor was.
            self._kept[floor.venue_id, floor.id, stored.sha256 or ""] = index
            while len(self._kept) > MAX_FLOORS:
                self._kept.popitem(last=False)
        return index

    def features(self, floor: Floor) -> FloorFeatures:
        """Return the features of a floor."""
        return self.index(floor).features

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
