"""Which of the motions between two pictures is right, by the third pictures that both are matched with."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import Pair
from app.engine.mapping.structure.windows.motions import Motion
from app.geometry.se3 import rotation_angle_deg
from app.limits import limit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class VoteOptions:
    """How third pictures vote."""

    max_turn_deg: float = limit(
        1.0,
        "Largest turn that is left after a way round three pictures for a vote; one of no turn counts fully.",
        chosen="By hand, on the video of `roomfix evaluate-video`: nine of ten right motions are exact to 0.1 "
        "degrees; a plane's wrong ones are degrees off.",
    )
    first_ratio: float = limit(
        0.7,
        "Votes of the motion with most inliers, relative to the most votes, with which it is taken.",
        chosen="By hand: votes differ by noise where both motions are nearly the same.",
    )


OPTIONS = VoteOptions()


def voted_motions(motions: Mapping[Pair, Sequence[Motion]]) -> dict[Pair, Motion]:
    """Return the motion of each pair whose turn fits best to those by way of third pictures.

    First all motions vote and those with few votes are left out, then each pair takes one, and at last votes on all of
    them again by what the others took.
    """
    beside: dict[int, set[int]] = defaultdict(set)
    for i, j in motions:
        beside[i].add(j)
        beside[j].add(i)
    left: Mapping[Pair, Sequence[Motion]] = motions
    for is_first in (True, False, False):
        chosen = {}
        for (i, j), own in motions.items():
            votes = [_votes(motion, i, j, beside[i] & beside[j], left) for motion in own]
            least = OPTIONS.first_ratio * max(votes)
            enough = [motion for motion, count in zip(own, votes, strict=True) if count >= least]
            chosen[i, j] = enough if is_first else enough[:1]
        left = chosen
    return {pair: own[0] for pair, own in left.items()}


def _votes(
    motion: Motion, i: int, j: int, thirds: set[int], motions: Mapping[Pair, Sequence[Motion]]
) -> float:
    total = 0.0
    back = motion.b_from_a.rotation.T
    for third in thirds:
        left = min(
            rotation_angle_deg(second @ first @ back)
            for first in _turns(i, third, motions)
            for second in _turns(third, j, motions)
        )
        total += max(0.0, 1.0 - left / OPTIONS.max_turn_deg)
    return total


def _turns(i: int, j: int, motions: Mapping[Pair, Sequence[Motion]]) -> list[Array]:
    """Return the rotations (3, 3) from one picture's camera to another's."""
    if i < j:
        return [motion.b_from_a.rotation for motion in motions[i, j]]
    return [motion.b_from_a.rotation.T for motion in motions[j, i]]
