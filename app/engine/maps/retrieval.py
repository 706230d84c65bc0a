"""Which keyframes a query is matched with: those that look most like it, and those that see what a pose sees."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.index import GlobalIndex
from app.vision.repetition import PLACE

EVALUATED = "roomfix evaluate and evaluate-demo; docs/features.md."


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrievalOptions:
    """Which keyframes show the same place, another place, or what a pose sees."""

    pool_keyframes: int = limit(
        200, "Ranks that are searched for other places that look alike.", chosen=EVALUATED
    )
    place_cosine: float = limit(
        0.5,
        "Keyframes whose optical axes have a smaller cosine than this show different places.",
        chosen="By hand: 60 degrees, the field of view of a phone.",
    )
    spot_radius_m: float = limit(
        1.5, "Of keyframes that look alike, one within this radius is enough.", chosen=EVALUATED
    )
    covisible_radius_m: float = limit(
        5.0, "Keyframes farther from a pose than this share nothing with it.", chosen=EVALUATED
    )
    covisible_cosine: float = limit(
        0.5,
        "Keyframes that look away from a pose's axis by more than this cosine share nothing with it.",
        chosen=EVALUATED,
    )
    covisible_turn_m: float = limit(
        2.0,
        "Metres that a difference of 1 in the cosine of the axes counts for when covisible keyframes are ranked.",
        chosen=EVALUATED,
    )


OPTIONS = RetrievalOptions()


class Retrieval:
    """Retrieval in one map."""

    def __init__(self, artifact: MapArtifact, index: GlobalIndex) -> None:
        self._index = index
        self._positions = artifact.arrays.positions
        self._axis_weights = PLACE.axis_weights(artifact.metadata.z_up)
        self._axes = artifact.axes()
        self._look_alikes: dict[tuple[int, int], list[int]] = {}
        self._cosines: dict[tuple[int, int], float] = {}

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
        rows, _ = self._index.search(
            descriptor, max(count, OPTIONS.pool_keyframes if other_places else 0), allowed
        )
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
        key = keyframe, count
        if key not in self._look_alikes:
            rows, _ = self._index.search(self._index.descriptor(keyframe), OPTIONS.pool_keyframes)
            chosen: list[int] = []
            for row in rows:
                elsewhere = not self._shown(int(row), [keyframe])
                if (
                    len(chosen) < count
                    and elsewhere
                    and not self._shown(int(row), chosen, OPTIONS.spot_radius_m)
                ):
                    chosen.append(int(row))
            self._look_alikes[key] = chosen
        return self._look_alikes[key]

    def look_alikes_of(
        self, keyframes: Sequence[int], count: int, allowed: NDArray[np.int64] | None = None
    ) -> list[int]:
        """Return up to `count` look-alikes of each of some keyframes, of the allowed ones."""
        twins = [twin for keyframe in keyframes for twin in self.look_alikes(keyframe, count)]
        return twins if allowed is None else [int(twin) for twin in np.array(twins)[np.isin(twins, allowed)]]

    def similarity_elsewhere(
        self, keyframes: Sequence[int], count: int, allowed: NDArray[np.int64] | None = None
    ) -> float:
        """Return the largest cosine of the global descriptors of some keyframes and of their look-alikes, 0 without
        any; `count` and `allowed` as in `look_alikes_of`."""
        pairs = [
            (keyframe, twin)
            for keyframe in keyframes
            for twin in self.look_alikes_of([keyframe], count, allowed)
        ]
        return max((self._cosine(pair) for pair in pairs), default=0.0)

    def _cosine(self, pair: tuple[int, int]) -> float:
        """Return the cosine of the global descriptors of two keyframes; kept as look-alikes are."""
        if pair not in self._cosines:
            self._cosines[pair] = float(self._index.descriptor(pair[0]) @ self._index.descriptor(pair[1]))
        return self._cosines[pair]

    def _shown(self, row: int, chosen: list[int], radius_m: float = PLACE.radius_m) -> bool:
        offsets = (self._positions[chosen] - self._positions[row]) * self._axis_weights
        near = np.linalg.norm(offsets, axis=1) < radius_m
        alike = self._axes[chosen] @ self._axes[row] > OPTIONS.place_cosine
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
        cost = distances + OPTIONS.covisible_turn_m * (1.0 - cosines)
        cost[(distances > OPTIONS.covisible_radius_m) | (cosines < OPTIONS.covisible_cosine)] = np.inf
        cost[list(known)] = np.inf
        if allowed is not None:
            outside = np.ones(len(cost), dtype=bool)
            outside[allowed] = False
            cost[outside] = np.inf
        # Few keyframes of a large map are near enough.
        possible = np.flatnonzero(np.isfinite(cost))
        return [int(i) for i in possible[np.argsort(cost[possible])][:count]]

    def distance_m(self, world_from_camera: Pose) -> float:
        """Return how far the nearest keyframe is."""
        return float(np.linalg.norm(self._positions - world_from_camera.translation, axis=1).min())
