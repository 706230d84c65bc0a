"""Matches of one query with keyframes of a map, merged into one set of pixels and world points."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.surroundings import MapSurroundings
from app.geometry.epipolar import filter_by_fundamental_matrix
from app.vision.features import LocalFeatureExtractor
from app.vision.images import Gray
from app.vision.matching import match_unit_vectors, to_unit_vectors

# A match is distinct when its distance is below this share of the distance to the most similar thing elsewhere in
# the map: the ratio test over the whole map instead of one keyframe.
DISTINCT_RATIO = 0.85


@dataclass(frozen=True, slots=True)
class Matches:
    """Matches of one query with several keyframes: pixels (n, 2), world points (n, 3), their sigma (n,), rows of
    the query's features (n,), keyframes (n,), and whether nothing elsewhere in the map looks like it (n,)."""

    points_px: NDArray[np.float64]
    points_in_world: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    query_rows: NDArray[np.intp]
    keyframes: NDArray[np.intp]
    distinct: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points_px)

    @property
    def feature_count(self) -> int:
        """How many of the query's features are matched, each counted once."""
        return len(np.unique(self.query_rows))

    @property
    def distinct_count(self) -> int:
        """How many of the query's features have a distinct match."""
        return len(np.unique(self.query_rows[self.distinct]))

    def take(self, mask: NDArray[np.bool_]) -> Matches:
        """Return the matches that the mask (n,) marks."""
        return Matches(
            self.points_px[mask],
            self.points_in_world[mask],
            self.sigma_m[mask],
            self.query_rows[mask],
            self.keyframes[mask],
            self.distinct[mask],
        )

    @staticmethod
    def merge(parts: Sequence[Matches]) -> Matches:
        """Return the matches of all parts."""
        if not parts:
            none = np.zeros(0, np.intp)
            return Matches(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), none, none, none.astype(bool))
        return Matches(
            np.concatenate([part.points_px for part in parts]),
            np.concatenate([part.points_in_world for part in parts]),
            np.concatenate([part.sigma_m for part in parts]),
            np.concatenate([part.query_rows for part in parts]),
            np.concatenate([part.keyframes for part in parts]),
            np.concatenate([part.distinct for part in parts]),
        )


class QueryMatcher:
    """Matches the features of one query with keyframes, each keyframe once.

    What looks alike matters only among the `allowed` keyframes.
    """

    def __init__(
        self,
        gray: Gray,
        artifact: MapArtifact,
        extractor: LocalFeatureExtractor,
        fundamental_filter: bool,
        allowed: NDArray[np.int64] | None = None,
    ) -> None:
        features = extractor.extract(gray)
        self.feature_count = len(features)
        self._matches: dict[int, Matches] = {}
        self._distances: dict[int, NDArray[np.float32]] = {}
        self._keypoints_px = features.keypoints_px
        self._unit = to_unit_vectors(features.descriptors, extractor.binary)
        self._artifact = artifact
        self._extractor = extractor
        self._fundamental_filter = fundamental_filter
        self._excluded = excluded_keyframes(artifact, allowed)

    @property
    def features(self) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """The pixels (n, 2) and unit descriptors (n, d) of the query's features."""
        return self._keypoints_px.astype(np.float64), self._unit

    @property
    def matched(self) -> Set[int]:
        """The keyframes that were matched so far."""
        return self._matches.keys()

    def match(self, keyframes: Sequence[int]) -> Matches:
        """Return the merged matches with the keyframes among these that were not matched before."""
        new = [keyframe for keyframe in dict.fromkeys(keyframes) if keyframe not in self._matches]
        self._matches.update((keyframe, self._match(keyframe)) for keyframe in new)
        return Matches.merge([self._matches[keyframe] for keyframe in new])

    def match_all(self, keyframes: Sequence[int]) -> Matches:
        """Return the merged matches with these keyframes and all that were matched before."""
        self.match(keyframes)
        return Matches.merge(list(self._matches.values()))

    def unrepeated_count(self, matches: Matches, surroundings: MapSurroundings) -> int:
        """Return how many features have a match, among these of this query, that is distinct by every view of what
        was matched."""
        # What isn't distinct by the view that was matched is not by all of them.
        matches = matches.take(matches.distinct)
        elsewhere = surroundings.distance_elsewhere(matches.points_in_world, self._excluded)
        distances = np.zeros(len(matches), np.float32)
        for keyframe in np.unique(matches.keyframes):
            mask = matches.keyframes == keyframe
            # A keyframe is matched with each feature of the query once, in their order.
            rows = np.searchsorted(self._matches[keyframe].query_rows, matches.query_rows[mask])
            distances[mask] = self._distances[keyframe][rows]
        return len(np.unique(matches.query_rows[distances < DISTINCT_RATIO * elsewhere]))

    def _match(self, keyframe: int) -> Matches:
        arrays, rows = self._artifact.arrays, self._artifact.rows(keyframe)
        theirs = to_unit_vectors(arrays.descriptors[rows], self._extractor.binary)
        a, b, _ = match_unit_vectors(self._unit, theirs, self._extractor.ratio, self._extractor.binary)
        if self._fundamental_filter:
            good = filter_by_fundamental_matrix(
                self._keypoints_px[a], arrays.keypoints_px[rows][b], estimator="ransac"
            )
            a, b = a[good], b[good]
        distances = unit_distances(self._unit[a], theirs[b])
        self._distances[keyframe] = distances
        return Matches(
            self._keypoints_px[a].astype(np.float64),
            arrays.points_in_world[rows][b].astype(np.float64),
            arrays.point_sigma_m[rows][b].astype(np.float64),
            a,
            np.full(len(a), keyframe, dtype=np.intp),
            are_distinct(self._artifact, rows.start + b, distances, self._excluded),
        )


def are_distinct(
    artifact: MapArtifact,
    rows: NDArray[np.intp],
    distances: NDArray[np.float32],
    excluded: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Return which matches (n,) of unit descriptors with features `rows` of a map nothing elsewhere in it rivals.

    `excluded`, from `excluded_keyframes`, are keyframes whose features don't count.
    """
    arrays = artifact.arrays
    distinct = distances < DISTINCT_RATIO * arrays.distance_elsewhere[rows]
    if excluded is not None:
        # The last entry answers for -1.
        distinct |= excluded[arrays.keyframe_elsewhere[rows]]
    return np.asarray(distinct)


def unit_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the distances (n,) of unit vectors (n, d) and (n, d)."""
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * np.einsum("ij,ij->i", a, b), 0.0)), dtype=np.float32)


def excluded_keyframes(artifact: MapArtifact, allowed: NDArray[np.int64] | None) -> NDArray[np.bool_] | None:
    """Return which keyframes are not allowed, and one entry more that is False; None when all are."""
    if allowed is None:
        return None
    excluded = np.ones(artifact.keyframe_count + 1, dtype=bool)
    excluded[allowed] = False
    excluded[-1] = False
    return excluded
