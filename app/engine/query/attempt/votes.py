"""Keyframes that share single things with a picture, whatever else the two show.

A global descriptor judges a picture as a whole: of a poster seen from aside in a corridor it finds the corridor. The
poster's own features are nowhere else in the map, and each that the picture has votes for the keyframes that have it.
Source: voting by local features as in Sivic and Zisserman, "Video Google", 2003, with descriptors in place of words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.maps.artifact import MapArtifact
from app.limits import limit
from app.vision.matching import to_unit_vectors


@dataclass(frozen=True, slots=True, kw_only=True)
class VoteOptions:
    """Which features vote, and for which keyframes."""

    query_features: int = limit(
        200, "Features of a picture that vote, evenly spread over all.", chosen="By hand: bounds the time."
    )
    map_features: int = limit(
        200_000,
        "Features of a map that are compared, evenly spread over all.",
        chosen="By hand: some tenths of a second; those of 500 keyframes.",
    )
    min_share: float = limit(
        0.25,
        "Least share of a map's features that are compared; in a larger map none votes.",
        chosen="By hand: that is 2,000 keyframes; fewer votes tell little, and cost reading all of a large file.",
    )
    chunk: int = limit(20_000, "Features of a map that are compared at once.", chosen="By hand: 16 MB.")
    distinct_ratio: float = limit(
        0.8,
        "A feature votes when its distance is below this ratio of that from the map's feature to its like elsewhere.",
        chosen="By hand: as strict as the ratio test between two pictures.",
    )
    max_distance: float = limit(
        0.5,
        "Largest distance of two unit descriptors of one thing, where the map has nothing like it elsewhere.",
        chosen="By hand: nearly all right matches are closer.",
    )
    min_votes: int = limit(
        4, "Fewest votes of a keyframe.", chosen="By hand: three fix a pose, the fourth tells."
    )


OPTIONS = VoteOptions()


def voted_keyframes(
    artifact: MapArtifact, unit: NDArray[np.float32], count: int, allowed: NDArray[np.int64] | None = None
) -> list[int]:
    """Return up to `count` keyframes, those with most votes of a picture's unit descriptors (n, d) first; none in a map
    of too many features.

    `allowed` restricts the keyframes. The map's descriptors are real numbers, not bits.
    """
    if OPTIONS.min_share * artifact.feature_count > OPTIONS.map_features:
        return []
    arrays = artifact.arrays
    voters = unit[:: max(1, -(-len(unit) // OPTIONS.query_features))]
    every = max(1, -(-artifact.feature_count // OPTIONS.map_features))
    pairs = [np.zeros((0, 2), np.intp)]
    for start in range(0, artifact.feature_count, OPTIONS.chunk * every):
        rows = np.arange(start, min(start + OPTIONS.chunk * every, artifact.feature_count), every)
        elsewhere = np.asarray(arrays.distance_elsewhere[rows], dtype=np.float32)
        apart = np.minimum(OPTIONS.distinct_ratio * elsewhere, OPTIONS.max_distance)
        # Two unit vectors are at a distance d when their product is 1 - d^2 / 2.
        likely = voters @ to_unit_vectors(arrays.descriptors[rows], binary=False).T > 1 - apart**2 / 2
        own, features = np.nonzero(likely)
        keyframes = np.searchsorted(arrays.offsets, rows[features], side="right") - 1
        pairs.append(np.stack([keyframes, own], axis=1))
    votes = np.bincount(np.unique(np.concatenate(pairs), axis=0)[:, 0], minlength=artifact.keyframe_count)
    if allowed is not None:
        barred = np.ones(artifact.keyframe_count, np.bool_)
        barred[allowed] = False
        votes[barred] = 0
    best = np.argsort(-votes, kind="stable")[:count]
    return [int(keyframe) for keyframe in best if votes[keyframe] >= OPTIONS.min_votes]
