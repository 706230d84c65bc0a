"""How one part of a path lies in another, by the pictures of one that see points of the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.engine.mapping.structure.matches import MatchedPictures
from app.engine.mapping.structure.parts.localized import Partners, PartPoints
from app.engine.mapping.structure.parts.similarity import Similarity, average_similarity
from app.engine.progress import Progress
from app.geometry.se3 import Pose, attitude_difference_rad
from app.limits import limit

Array = NDArray[np.float64]
STAGE = "join_parts"


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOptions:
    """When pictures agree on how one part lies in another."""

    min_pictures: int = limit(
        3,
        "Pictures that must agree.",
        chosen="By hand: two may be neighbours with the same false matches.",
    )
    min_agreeing_share: float = limit(
        0.6,
        "Least share of the pictures that are localized in the other part which agree.",
        chosen="By hand: of a part whose path broke inside, or of two places that look alike, fewer do.",
    )
    min_shared_points: int = limit(
        12,
        "Points that both parts have of one picture, from which the ratio of the scales follows.",
        chosen="By hand: for a median.",
    )
    max_scale_ratio: float = limit(
        1.1,
        "Largest ratio of the scales by two pictures that agree.",
        chosen="By hand: the scale of a part of tens of pictures drifts by some percent.",
    )
    max_turn_deg: float = limit(
        6.0, "Largest difference of the attitudes by two that agree.", chosen="By hand: as of a loop."
    )
    max_apart_ratio: float = limit(
        0.15,
        "Largest difference of the positions by two that agree, relative to the median depth.",
        chosen="By hand: a step to the side; look-alike places are further apart.",
    )
    drift_ratio: float = limit(
        0.1,
        "The same, per distance between the two pictures.",
        chosen="By hand: what the scales may differ by.",
    )


OPTIONS = LinkOptions()


@dataclass(frozen=True, slots=True)
class Tie:
    """A picture with a pose in two parts, and the units of the second per unit of the first by the points of both."""

    row: int
    in_a: Pose
    in_b: Pose
    scale: float

    @property
    def b_from_a(self) -> Similarity:
        """How the first part lies in the second, by this picture alone."""
        return Similarity.of_camera(self.in_a, self.in_b, self.scale)

    def turned(self) -> Tie:
        """Return it from the second part to the first."""
        return Tie(self.row, self.in_b, self.in_a, 1.0 / self.scale)


@dataclass(frozen=True, slots=True)
class Link:
    """How part `a` lies in part `b` (rows of a list of parts), and the pictures that agree on it."""

    a: int
    b: int
    b_from_a: Similarity
    ties: tuple[Tie, ...]


def find_links(
    parts: Sequence[PartPoints], matched: MatchedPictures, partners: Partners, progress: Progress
) -> list[Link]:
    """Return how the parts lie in each other, where enough of their pictures agree."""
    found = []
    for a, first in enumerate(parts):
        progress.report(STAGE, a, len(parts))
        for b in range(a + 1, len(parts)):
            ties = [
                *ties_between(first, parts[b], matched, partners),
                *(tie.turned() for tie in ties_between(parts[b], first, matched, partners)),
            ]
            agreeing = agreeing_ties(ties, parts[b].median_depth)
            if len({tie.row for tie in agreeing}) >= OPTIONS.min_pictures:
                found.append(Link(a, b, _average(agreeing), tuple(agreeing)))
    return found


def ties_between(a: PartPoints, b: PartPoints, matched: MatchedPictures, partners: Partners) -> list[Tie]:
    """Return the pictures of part `a` that are localized in the points of `b`."""
    found = []
    for row, in_a in a.part.poses.items():
        seen = b.localize(row, matched, partners)
        if seen is None:
            continue
        own = a.point_of[row][seen.features]
        depth_a = a.depth(in_a, own[own >= 0])
        depth_b = b.depth(seen.pose, seen.points[own >= 0])
        in_front = (depth_a > 0) & (depth_b > 0)
        if in_front.sum() >= OPTIONS.min_shared_points:
            ratio = np.log(depth_b[in_front] / depth_a[in_front])
            found.append(Tie(row, in_a, seen.pose, float(np.exp(np.median(ratio)))))
    return found


def agreeing_ties(ties: Sequence[Tie], depth: float) -> list[Tie]:
    """Return the most pictures that agree with one of them; none where most of the others contradict.

    `depth` is the median depth in the second part.
    """
    groups = [[tie for tie in ties if agrees(own.b_from_a, own.in_b, tie, depth)] for own in ties]
    best = max(groups, key=len, default=[])
    return best if len(best) >= OPTIONS.min_agreeing_share * len(ties) else []


def agrees(b_from_a: Similarity, near: Pose, tie: Tie, depth: float) -> bool:
    """Return whether a picture may confirm how one part lies in another, by a picture whose pose there is `near`."""
    expected = b_from_a.move(tie.in_a)
    way = float(np.linalg.norm(tie.in_b.translation - near.translation))
    apart = float(np.linalg.norm(expected.translation - tie.in_b.translation))
    return bool(
        abs(np.log(tie.scale / b_from_a.scale)) <= np.log(OPTIONS.max_scale_ratio)
        and attitude_difference_rad(expected, tie.in_b) <= np.radians(OPTIONS.max_turn_deg)
        and apart <= OPTIONS.max_apart_ratio * depth + OPTIONS.drift_ratio * way
    )


def _average(ties: Sequence[Tie]) -> Similarity:
    return average_similarity(
        [tie.in_a for tie in ties], [tie.in_b for tie in ties], np.array([tie.scale for tie in ties])
    )
