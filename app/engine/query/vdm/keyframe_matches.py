"""Matches of one query with single keyframes, in pixels of both pictures and with the keyframe's points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.open_map import OpenMap
from app.engine.query.matches import are_distinct, excluded_keyframes
from app.vision.images import Gray
from app.vision.matching import match_with_each, to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
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
            keyframe=self.keyframe,
            query_rows=self.query_rows[mask],
            query_px=self.query_px[mask],
            keyframe_px=self.keyframe_px[mask],
            points_in_world=self.points_in_world[mask],
            sigma_m=self.sigma_m[mask],
            distinct=self.distinct[mask],
        )


def match_keyframes(
    gray: Gray, keyframes: Sequence[int], opened: OpenMap, allowed: NDArray[np.int64] | None = None
) -> list[KeyframeMatches]:
    """Return the matches of a grey image (height, width) with each of the keyframes, those with most first.

    What looks alike matters only among the `allowed` ones.
    """
    artifact, extractor = opened.artifact, opened.extractor
    features = extractor.extract(gray)
    unit = to_unit_vectors(features.descriptors, extractor.binary)
    arrays, found = artifact.arrays, []
    excluded = excluded_keyframes(artifact, allowed)
    keyframes = list(dict.fromkeys(keyframes))
    pairs = match_with_each(
        unit, arrays.descriptors, arrays.offsets, keyframes, extractor.ratio, extractor.binary
    )
    for keyframe, (a, rows, distances) in zip(keyframes, pairs, strict=True):
        found.append(
            KeyframeMatches(
                keyframe=keyframe,
                query_rows=a,
                query_px=features.keypoints_px[a].astype(np.float64),
                keyframe_px=arrays.keypoints_px[rows].astype(np.float64),
                points_in_world=arrays.points_in_world[rows].astype(np.float64),
                sigma_m=arrays.point_sigma_m[rows].astype(np.float64),
                distinct=are_distinct(artifact, rows, distances, excluded),
            )
        )
    return sorted(found, key=len, reverse=True)
