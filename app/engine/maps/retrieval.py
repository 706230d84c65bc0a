"""Which keyframes a query is matched with: those that look most like it, and those that see what a pose sees."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.geometry.se3 import Pose
from app.vision.index import GlobalIndex

# So many ranks are looked through for places that look alike.
POOL = 200
# Keyframes further apart than this, or turned further, show another place.
PLACE_RADIUS_M = 4.0
PLACE_COSINE = 0.5
# Heights count this much more than lengths along the floor: the next floor is another place, 3 m away or not.
HEIGHT_WEIGHT = 3.0
# Of places that look alike one keyframe each metre and a half is enough.
SPOT_RADIUS_M = 1.5
# Keyframes further from a pose than this, or looking elsewhere, share nothing with it.
COVISIBLE_RADIUS_M = 5.0
COVISIBLE_COSINE = 0.5


class Retrieval:
    """Retrieval in one map."""

    def __init__(self, artifact: MapArtifact, index: GlobalIndex) -> None:
        self._index = index
        self._positions = artifact.arrays.positions
        self._axes = np.stack([artifact.pose(i).rotation[:, 2] for i in range(artifact.keyframe_count)])
        self._look_alikes: dict[int, list[int]] = {}

    def similar(
        self,
        descriptor: NDArray[np.float32],
        count: int,
        other_places: int,
        allowed: NDArray[np.int64] | None = None,
    ) -> list[int]:
        """Return the `count` keyframes nearest to a global descriptor (d,) (A eq. 4), then the nearest one of each
        of up to `other_places` places that none of these shows.

        Where two places look alike the nearest keyframes may all show the wrong one: the others are what tells.
        """
        rows, _ = self._index.search(descriptor, max(count, POOL if other_places else 0), allowed)
        chosen = [int(row) for row in rows[:count]]
        for row in rows[count:]:
            if len(chosen) >= count + other_places:
                break
            if not self._shown(int(row), chosen):
                chosen.append(int(row))
        return chosen

    def look_alikes(self, keyframe: int, count: int) -> list[int]:
        """Return up to `count` keyframes of other places that look most like one, each of another spot.

        A property of the map: computed when first asked for, then kept.
        """
        if keyframe not in self._look_alikes:
            rows, _ = self._index.search(self._index.descriptor(keyframe), POOL)
            chosen: list[int] = []
            for row in rows:
                elsewhere = not self._shown(int(row), [keyframe])
                if len(chosen) < count and elsewhere and not self._shown(int(row), chosen, SPOT_RADIUS_M):
                    chosen.append(int(row))
            self._look_alikes[keyframe] = chosen
        return self._look_alikes[keyframe]

    def _shown(self, row: int, chosen: list[int], radius_m: float = PLACE_RADIUS_M) -> bool:
        offsets = (self._positions[chosen] - self._positions[row]) * [1.0, 1.0, HEIGHT_WEIGHT]
        near = np.linalg.norm(offsets, axis=1) < radius_m
        alike = self._axes[chosen] @ self._axes[row] > PLACE_COSINE
        return bool(np.any(near & alike))

    def covisible(
        self,
        world_from_camera: Pose,
        count: int,
        known: Set[int],
        allowed: NDArray[np.int64] | None = None,
    ) -> list[int]:
        """Return up to `count` keyframes, none of them known, that see what a pose sees, best first."""
        distances = np.linalg.norm(self._positions - world_from_camera.translation, axis=1)
        cosines = self._axes @ world_from_camera.rotation[:, 2]
        cost = distances + 2.0 * (1.0 - cosines)
        cost[(distances > COVISIBLE_RADIUS_M) | (cosines < COVISIBLE_COSINE)] = np.inf
        cost[list(known)] = np.inf
        if allowed is not None:
            outside = np.ones(len(cost), dtype=bool)
            outside[allowed] = False
            cost[outside] = np.inf
        order = np.argsort(cost)[:count]
        return [int(i) for i in order if np.isfinite(cost[i])]

    def distance_m(self, world_from_camera: Pose) -> float:
        """Return how far the nearest keyframe is."""
        return float(np.linalg.norm(self._positions - world_from_camera.translation, axis=1).min())
