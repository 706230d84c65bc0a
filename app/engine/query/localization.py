"""What localizing one frame leads to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.engine.query.matches import Matches
from app.engine.query.verification import Evidence, Reason
from app.engine.stage_timer import StageTimer
from app.geometry.camera import Camera
from app.geometry.se3 import Pose

# Two poses nearer than this, in both respects, are one place.
SAME_PLACE_M, SAME_PLACE_COSINE = 0.5, float(np.cos(np.radians(15)))


@dataclass(frozen=True, slots=True)
class KeyframeVote:
    """A keyframe that was matched, and how many of its matches agree with the pose."""

    keyframe: int
    matches: int
    inliers: int


@dataclass(frozen=True, slots=True)
class Localization:
    """The outcome for one frame. `world_from_camera` is None exactly when `reason` says why.

    `position_m`, `orientation_deg`: one sigma; `confidence`: probability that the error is below 0.5 m and 5
    degrees; `timings_ms` by stage. `candidate` is the pose that was judged, trusted or not: for evaluation only.
    """

    world_from_camera: Pose | None
    reason: Reason | None
    evidence: Evidence
    position_m: float | None
    orientation_deg: float | None
    confidence: float
    keyframes: tuple[KeyframeVote, ...]
    camera: Camera | None
    timings_ms: dict[str, float]
    candidate: Pose | None = None


def same_place(a: Pose, b: Pose) -> bool:
    """Return whether two `world_from_camera` are near in place and direction."""
    apart_m = float(np.linalg.norm(a.translation - b.translation))
    return apart_m < SAME_PLACE_M and float(a.rotation[:, 2] @ b.rotation[:, 2]) > SAME_PLACE_COSINE


def votes_of(matches: Matches, inliers: Matches) -> tuple[KeyframeVote, ...]:
    """Return the votes of the keyframes behind matches, most inliers first."""
    ids, counts = np.unique(matches.keyframes, return_counts=True)
    agreed = {int(i): int(n) for i, n in zip(*np.unique(inliers.keyframes, return_counts=True), strict=True)}
    votes = [KeyframeVote(int(i), int(n), agreed.get(int(i), 0)) for i, n in zip(ids, counts, strict=True)]
    return tuple(sorted(votes, key=lambda vote: -vote.inliers))


def nothing_found(
    reason: Reason, timer: StageTimer, matches: int = 0, camera: Camera | None = None
) -> Localization:
    """Return the outcome for a frame without any pose to judge."""
    return Localization(None, reason, Evidence.none(matches), None, None, 0.0, (), camera, timer.milliseconds)
