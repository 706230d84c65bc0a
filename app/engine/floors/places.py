"""Finds the area that holds a plan point, and the landmark nearest to it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import shapely  # type: ignore[import-untyped]
from numpy.typing import NDArray

from app.engine.floors.model import Area, FloorFeatures, Landmark


@dataclass(frozen=True, slots=True)
class NearestLandmark:
    """A landmark and its straight distance."""

    landmark: Landmark
    distance_m: float


class PlaceIndex:
    """Finds areas and landmarks of one floor by plan position. Built once per revision of the features."""

    def __init__(self, features: FloorFeatures) -> None:
        self.features = features
        self._areas = shapely.STRtree([area.polygon for area in features.areas])
        self._landmarks = list(features.landmarks.values())
        self._points = np.array([(mark.x, mark.y) for mark in self._landmarks]).reshape(-1, 2)

    def area(self, x: float, y: float) -> Area | None:
        """Return the smallest area that holds a point or has it on its border, None when there is none."""
        found = self._areas.query(shapely.Point(x, y), predicate="intersects")
        inside = [self.features.areas[index] for index in found]
        return min(inside, key=lambda area: (area.polygon.area, area.id), default=None)

    def nearest_landmark(self, x: float, y: float) -> NearestLandmark | None:
        """Return the nearest landmark; when the area at the point has landmarks, the nearest of these.

        A landmark in another room is behind a wall and can't be seen.
        """
        if not self._landmarks:
            return None
        distances_m = np.hypot(self._points[:, 0] - x, self._points[:, 1] - y)
        area = self.area(x, y)
        if area is not None:
            seen = shapely.intersects_xy(area.polygon, self._points)
            if seen.any():
                distances_m = np.where(seen, distances_m, np.inf)
        best = int(np.argmin(distances_m))
        return NearestLandmark(self._landmarks[best], float(distances_m[best]))


def within_areas(points: NDArray[np.float64], areas: Iterable[Area], margin_m: float) -> NDArray[np.bool_]:
    """Return which plan points (n, 2) lie in one of the areas or at most `margin_m` outside: a mask (n,)."""
    keep = np.zeros(len(points), dtype=bool)
    for area in areas:
        keep |= shapely.intersects_xy(area.polygon.buffer(margin_m), points)
    return keep


def areas_named(features: FloorFeatures, text: str) -> list[Area]:
    """Return the area of that id, else all areas of that name; case doesn't matter in names."""
    by_id = [area for area in features.areas if area.id == text]
    wanted = text.strip().casefold()
    return by_id or [area for area in features.areas if area.name.casefold() == wanted]
