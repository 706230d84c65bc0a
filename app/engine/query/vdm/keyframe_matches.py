"""Matches of one query with single keyframes, in pixels of both pictures and with the keyframe's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.engine.query.matches import are_distinct, excluded_keyframes, unit_distances
from app.vision.features import LocalFeatureExtractor
from app.vision.images import Gray
from app.vision.matching import match_unit_vectors, to_unit_vectors


@dataclass(frozen=True, slots=True)
class KeyframeMatches:
    """Matches with one keyframe: rows (n,) of the query's features, pixels (n, 2) of query and keyframe, world
    points (n, 3) and their sigma (n,) in metres, and whether nothing elsewhere in the map looks like it (n,)."""

    keyframe: int
    query_rows: NDArray[np.intp]
    query_px: NDArray[np.float64]
    keyframe_px: NDArray[np.float64]
    points_in_world: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    distinct: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.query_rows)

    def take(self, mask: NDArray[np.bool_]) -> KeyframeMatches:
        """Return the matches that the mask (n,) marks."""
        return KeyframeMatches(
            self.keyframe,
            self.query_rows[mask],
            self.query_px[mask],
            self.keyframe_px[mask],
            self.points_in_world[mask],
            self.sigma_m[mask],
            self.distinct[mask],
        )


def match_keyframes(
    gray: Gray,
    keyframes: Sequence[int],
    artifact: MapArtifact,
    extractor: LocalFeatureExtractor,
    allowed: NDArray[np.int64] | None = None,
) -> list[KeyframeMatches]:
    """Return the matches of a grey image (height, width) with each of the keyframes, those with most first.

    What looks alike matters only among the `allowed` ones.
    """
    features = extractor.extract(gray)
    unit = to_unit_vectors(features.descriptors, extractor.binary)
    arrays, found = artifact.arrays, []
    excluded = excluded_keyframes(artifact, allowed)
    for keyframe in dict.fromkeys(keyframes):
        rows = artifact.rows(keyframe)
        theirs = to_unit_vectors(arrays.descriptors[rows], extractor.binary)
        a, b, _ = match_unit_vectors(unit, theirs, extractor.ratio, extractor.binary)
        found.append(
            KeyframeMatches(
                keyframe,
                a,
                features.keypoints_px[a].astype(np.float64),
                arrays.keypoints_px[rows][b].astype(np.float64),
                arrays.points_in_world[rows][b].astype(np.float64),
                arrays.point_sigma_m[rows][b].astype(np.float64),
                are_distinct(artifact, rows.start + b, unit_distances(unit[a], theirs[b]), excluded),
            )
        )
    return sorted(found, key=len, reverse=True)
