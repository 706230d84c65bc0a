"""A pose that several frames of known motion may have, and the evidence of all of them for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.engine.query.localization import same_place
from app.engine.query.matches import Matches, QueryMatcher
from app.engine.query.placed import Support
from app.engine.query.several.options import OPTIONS
from app.engine.query.verification import Evidence, coverage
from app.geometry.se3 import Pose

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigHypothesis:
    """A pose of frame 0 with, for each frame, its matches, those that agree, and those of them that count.

    What several frames show counts once, in the frame with most inliers: frames of a burst are nearly the same picture,
    and what is wrong in one is wrong in all.
    """

    world_from_first: Pose
    matches: tuple[Matches, ...]
    inliers: tuple[Matches, ...]
    counted: tuple[Matches, ...]
    masks: tuple[Mask, ...]

    @staticmethod
    def of(world_from_first: Pose, matches: Sequence[Matches], masks: Sequence[Mask]) -> RigHypothesis:
        """Return the hypothesis of a pose and of the matches that agree with it, each frame's marked by its mask."""
        inliers = tuple(own.take(mask) for own, mask in zip(matches, masks, strict=True))
        return RigHypothesis(
            world_from_first=world_from_first,
            matches=tuple(matches),
            inliers=inliers,
            counted=counted_once(inliers),
            masks=tuple(masks),
        )

    @property
    def count(self) -> int:
        """How many features of all frames agree, each thing counted once."""
        return sum(own.feature_count for own in self.counted)

    @property
    def rest(self) -> tuple[Matches, ...]:
        """The matches of each frame that don't agree."""
        return tuple(own.take(~mask) for own, mask in zip(self.matches, self.masks, strict=True))

    @property
    def frames(self) -> tuple[Support, ...]:
        """The support by each frame."""
        return tuple(
            Support(agree.feature_count, own.feature_count)
            for agree, own in zip(self.inliers, self.matches, strict=True)
        )

    @property
    def is_confirmed(self) -> bool:
        """Whether frame 0 itself, or two other frames, speak for the pose: another frame alone says nothing of the
        motion between it and frame 0."""
        speak = [support.inliers >= OPTIONS.min_frame_inliers for support in self.frames]
        return speak[0] or sum(speak) >= 2

    def is_same_place(self, other: RigHypothesis) -> bool:
        """Whether two hypotheses are near each other."""
        return same_place(self.world_from_first, other.world_from_first)


def counted_once(inliers: Sequence[Matches]) -> tuple[Matches, ...]:
    """Return the inliers of each frame whose things no frame with more inliers shows."""
    order = sorted(range(len(inliers)), key=lambda frame: -inliers[frame].feature_count)
    counted: dict[int, Matches] = {}
    known = np.zeros((0, 3))
    for frame in order:
        own = inliers[frame]
        if len(known) and len(own):
            distances, _ = cKDTree(known).query(own.points_in_world)
            seen_before = own.query_rows[distances < OPTIONS.same_thing_m]
            own = own.take(~np.isin(own.query_rows, seen_before))
        counted[frame] = own
        known = np.concatenate([known, own.points_in_world])
    return tuple(counted[frame] for frame in range(len(inliers)))


def rig_evidence(
    best: RigHypothesis,
    rival: RigHypothesis | None,
    matchers: Sequence[QueryMatcher],
    keyframe_distance_m: float,
    position_sigma_m: float,
) -> Evidence:
    """Return the evidence of all frames for the best pose, each thing counted once; matches are in proportion.

    Cells of the frames' grids that hold what counts add up to the coverage, of at most one whole picture.
    """
    agree = sum(support.inliers for support in best.frames)
    matched = sum(support.matches for support in best.frames)
    covered = sum(
        coverage(own.points_px, matcher.query.size_px)
        for own, matcher in zip(best.counted, matchers, strict=True)
        if len(own)
    )
    rows = [(own.query_rows, other.query_rows) for own, other in _pairs(best, rival)]
    return Evidence(
        matches=round(best.count * matched / agree) if agree else matched,
        inliers=best.count,
        coverage=min(covered, 1.0),
        distinct=sum(own.distinct_count for own in best.counted),
        rival=0 if rival is None else rival.count,
        rival_only=sum(len(np.setdiff1d(other, own)) for own, other in rows),
        pose_only=sum(len(np.setdiff1d(own, other)) for own, other in rows),
        keyframe_distance_m=keyframe_distance_m,
        position_sigma_m=position_sigma_m,
        unrepeated=sum(
            matcher.unrepeated_count(own) for own, matcher in zip(best.counted, matchers, strict=True)
        ),
    )


def _pairs(best: RigHypothesis, rival: RigHypothesis | None) -> list[tuple[Matches, Matches]]:
    others = rival.counted if rival is not None else tuple(Matches.none() for _ in best.counted)
    return list(zip(best.counted, others, strict=True))
