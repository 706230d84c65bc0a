"""Matches of one query with keyframes of a map, merged into one set of pixels and world points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.engine.query.query import Query
from app.engine.stage_timer import clock_s
from app.geometry.epipolar import filter_by_fundamental_matrix
from app.limits import limit
from app.vision.features import LocalFeatureExtractor
from app.vision.matching import match_with_each, to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOptions:
    """When a match is distinct in the whole map."""

    distinct_ratio: float = limit(
        0.85,
        "A match is distinct when its descriptor distance is below this ratio of the distance to the most similar "
        "feature at another place: the ratio test over the whole map instead of one keyframe.",
        chosen="The ratio test's own threshold for SIFT; roomfix evaluate-demo, docs/features.md.",
    )


OPTIONS = MatchOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """Matches of one query with several keyframes: pixels (n, 2), world points (n, 3), their sigma (n,), rows of
    the query's features (n,), keyframes (n,), distances of the unit descriptors (n,), and whether nothing elsewhere in
    the map looks like it (n,)."""

    points_px: NDArray[np.float64]
    points_in_world: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    query_rows: NDArray[np.intp]
    keyframes: NDArray[np.intp]
    distances: NDArray[np.float32]
    distinct: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points_px)

    @property
    def feature_count(self) -> int:
        """How many of the query's features are matched, each counted once."""
        return len(np.unique(self.query_rows))

    def feature_counts(self, masks: Iterable[NDArray[np.bool_]]) -> list[int]:
        """Return how many of the query's features have a match that a mask (n,) marks, for each mask."""
        return [len(np.unique(self.query_rows[mask])) for mask in masks]

    @property
    def distinct_count(self) -> int:
        """How many of the query's features have a distinct match."""
        return len(np.unique(self.query_rows[self.distinct]))

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Matches:
        """Return the matches that a mask (n,) marks, or those at rows (m,)."""
        return Matches(**{name: getattr(self, name)[chosen] for name in FIELDS})

    @staticmethod
    def none() -> Matches:
        """Return no matches."""
        rows = np.zeros(0, np.intp)
        return Matches(
            points_px=np.zeros((0, 2)),
            points_in_world=np.zeros((0, 3)),
            sigma_m=np.zeros(0),
            query_rows=rows,
            keyframes=rows,
            distances=np.zeros(0, np.float32),
            distinct=np.zeros(0, bool),
        )

    @staticmethod
    def merge(parts: Sequence[Matches]) -> Matches:
        """Return the matches of all parts."""
        if not parts:
            return Matches.none()
        return Matches(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS})


FIELDS = tuple(field.name for field in fields(Matches))


class QueryMatcher:
    """Matches the features of one query with keyframes, each keyframe once.

    What looks alike matters only among the keyframes that the query allows.
    """

    def __init__(
        self,
        query: Query,
        opened: OpenMap,
        extractor: LocalFeatureExtractor | None = None,
        fundamental_filter: bool = False,
    ) -> None:
        self.query = query
        self._map = opened
        self._extractor = extractor or opened.extractor
        self._fundamental_filter = fundamental_filter
        self._excluded = excluded_keyframes(opened.artifact, query.allowed)
        self._matches: dict[int, Matches] = {}
        # The keyframes that were matched so far.
        self.matched: Set[int] = self._matches.keys()
        started = clock_s()
        features = self._extractor.extract(query.gray)
        self.feature_count = len(features)
        self._keypoints_px = features.keypoints_px
        self._unit = to_unit_vectors(features.descriptors, self._extractor.binary)
        # The pixels (n, 2) and unit descriptors (n, d) of the query's features.
        self.features = self._keypoints_px.astype(np.float64), self._unit
        query.spent_s["describe"] += clock_s() - started

    def match(self, keyframes: Iterable[int]) -> Matches:
        """Return the merged matches with the keyframes among these that were not matched before."""
        started = clock_s()
        new = [keyframe for keyframe in dict.fromkeys(keyframes) if keyframe not in self._matches]
        self._matches.update(zip(new, self._match(new), strict=True))
        merged = Matches.merge([self._matches[keyframe] for keyframe in new])
        self.query.spent_s["match"] += clock_s() - started
        return merged

    def match_all(self, keyframes: Iterable[int]) -> Matches:
        """Return the merged matches with these keyframes and all that were matched before."""
        self.match(keyframes)
        return Matches.merge(list(self._matches.values()))

    def unrepeated_count(self, matches: Matches) -> int:
        """Return how many features have a match, among these of this query, that is distinct by every view of what
        was matched."""
        # What isn't distinct by the view that was matched is not distinct by all of them.
        matches = matches.take(matches.distinct)
        elsewhere = self._map.surroundings.distance_elsewhere(matches.points_in_world, self._excluded)
        distinct = matches.distances < OPTIONS.distinct_ratio * elsewhere
        return len(np.unique(matches.query_rows[distinct]))

    def _match(self, keyframes: Sequence[int]) -> list[Matches]:
        artifact, extractor = self._map.artifact, self._extractor
        arrays = artifact.arrays
        pairs = match_with_each(
            self._unit, arrays.descriptors, arrays.offsets, keyframes, extractor.ratio, extractor.binary
        )
        found = []
        for keyframe, (a, rows, distances) in zip(keyframes, pairs, strict=True):
            if self._fundamental_filter:
                good = filter_by_fundamental_matrix(
                    self._keypoints_px[a], arrays.keypoints_px[rows], estimator="ransac"
                )
                a, rows, distances = a[good], rows[good], distances[good]  # noqa: PLW2901 - of the same match
            found.append(
                Matches(
                    points_px=self._keypoints_px[a].astype(np.float64),
                    points_in_world=arrays.points_in_world[rows].astype(np.float64),
                    sigma_m=arrays.point_sigma_m[rows].astype(np.float64),
                    query_rows=a,
                    keyframes=np.full(len(a), keyframe, dtype=np.intp),
                    distances=distances,
                    distinct=are_distinct(artifact, rows, distances, self._excluded),
                )
            )
        return found


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
    distinct = distances < OPTIONS.distinct_ratio * arrays.distance_elsewhere[rows]
    if excluded is not None:
        # The last entry answers for -1.
        distinct |= excluded[arrays.keyframe_elsewhere[rows]]
    return np.asarray(distinct)


def excluded_keyframes(artifact: MapArtifact, allowed: NDArray[np.int64] | None) -> NDArray[np.bool_] | None:
    """Return which keyframes are not allowed, and one entry more that is False; None when all are."""
    if allowed is None:
        return None
    excluded = np.ones(artifact.keyframe_count + 1, dtype=bool)
    excluded[allowed] = False
    excluded[-1] = False
    return excluded
