"""What looks like something elsewhere in a map, judged by every view of it instead of the one that was matched.

A feature knows how far off the most similar feature at another place is. Where the other place was scanned from other
directions only, that is far although the same thing hangs there; another view of the thing on this side tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact, Places
from app.engine.maps.repetition import rows_of_keyframes, views_of
from app.limits import limit

# Bits of a cell's number for each axis: 80 km each way.
BITS = 21


@dataclass(frozen=True, slots=True, kw_only=True)
class SurroundingsOptions:
    """Which features are views of the same thing."""

    radius_m: float = limit(
        0.08,
        "Features within this radius are views of one thing; a larger one reaches, in a furnished "
        "room, something that is found elsewhere too.",
        chosen="roomfix evaluate-demo and evaluate; docs/features.md.",
    )


OPTIONS = SurroundingsOptions()

Rows = NDArray[np.int64]


def places_of(artifact: MapArtifact) -> Places:
    """Return a map's features by place."""
    arrays = artifact.arrays
    views = views_of(artifact.poses())
    rows = rows_of_keyframes(views, arrays.offsets)
    keys = _keys(_cells(arrays.points_in_world[rows]))
    order = np.argsort(keys, kind="stable")
    return Places(views.astype(np.int32), rows[order].astype(np.int32), keys[order])


def with_places(artifact: MapArtifact) -> MapArtifact:
    """Return a map with all that opening it would compute, to be written."""
    return artifact if artifact.places is not None else replace(artifact, places=places_of(artifact))


class MapSurroundings:
    """A map's features by place. Immutable, safe to share between threads."""

    def __init__(self, artifact: MapArtifact) -> None:
        self._artifact = artifact
        places = artifact.places or places_of(artifact)
        self._order, self._keys = places.feature_rows, places.cell_keys

    def distance_elsewhere(
        self, points_in_world: NDArray[np.float64], excluded: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float32]:
        """Return the least `distance_elsewhere` (n,) of the map's features around points (n, 3); infinite where there
        are none.

        `excluded`, from `services.matches.excluded_keyframes`, are keyframes whose features don't count, neither
        here nor elsewhere.
        """
        least = np.full(len(points_in_world), np.inf, np.float32)
        cells = _cells(points_in_world)
        for step in np.ndindex(3, 3):
            owners, rows = self._within(cells + np.array([*step, 1]) - 1)
            offsets = self._artifact.arrays.points_in_world[rows] - points_in_world[owners]
            near = np.einsum("ij,ij->i", offsets, offsets) <= OPTIONS.radius_m**2
            if excluded is not None:
                near &= ~self._left_out(rows, excluded)
            distances = self._artifact.arrays.distance_elsewhere[rows[near]].astype(np.float32)
            np.minimum.at(least, owners[near], distances)
        return least

    def _within(self, cells: Rows) -> tuple[Rows, Rows]:
        """Return for every feature in cells (n, 3), and in those above and below, the number of its cell and its
        row."""
        # Cells on top of each other have successive keys.
        keys = _keys(cells)
        first = self._keys.searchsorted(keys - 1, side="left")
        counts = self._keys.searchsorted(keys + 1, side="right") - first
        owners = np.repeat(np.arange(len(keys)), counts)
        within = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
        return owners, self._order[first[owners] + within].astype(np.int64)

    def _left_out(self, rows: Rows, excluded: NDArray[np.bool_]) -> NDArray[np.bool_]:
        arrays = self._artifact.arrays
        own = np.searchsorted(arrays.offsets, rows, side="right") - 1
        return np.asarray(excluded[own] | excluded[arrays.keyframe_elsewhere[rows]])


def _cells(points: NDArray[np.float64] | NDArray[np.float32]) -> Rows:
    return np.floor(points / OPTIONS.radius_m).astype(np.int64)


def _keys(cells: Rows) -> Rows:
    x, y, z = (cells + (1 << BITS - 1)).T
    return np.asarray((x << 2 * BITS) | (y << BITS) | z)
