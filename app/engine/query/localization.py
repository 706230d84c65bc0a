"""What localizing one frame leads to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.engine.query.hints import Hint
from app.engine.query.intrinsics import CameraTrust
from app.engine.query.matches import Matches
from app.engine.query.placed import Accuracy, Support
from app.engine.query.verification import Evidence, Reason
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit


@dataclass(frozen=True, slots=True, kw_only=True)
class SamePlaceOptions:
    """When two poses are one place: near in both respects."""

    distance_m: float = limit(0.5, "Poses nearer than this may be one place.", chosen="By hand: a step.")
    angle_deg: float = limit(
        15.0,
        "Optical axes closer than this may be one place.",
        chosen="By hand: well within a field of view.",
    )


SAME_PLACE = SamePlaceOptions()
SAME_PLACE_COSINE = float(np.cos(np.radians(SAME_PLACE.angle_deg)))


@dataclass(frozen=True, slots=True)
class KeyframeVote:
    """A keyframe that was matched, and how many of its matches agree with the pose."""

    keyframe: int
    matches: int
    inliers: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Localization:
    """The outcome for one frame. `world_from_camera` is None exactly when `reason` says why.

    `accuracy` is one sigma, None where it isn't known; `accuracy_among` the same among pictures of one camera, where
    that is less; `confidence` the probability that the error is below 0.5 m and
    5 degrees; `timings_ms` by stage. `candidate` is the pose that was judged, trusted or not: a prior may still decide
    for it. `camera_trust` is what the matches say of the stated camera; where it is refined they fit another one far
    better, and `camera` is it.
    `hints` say what would help a frame that is not located.
    `inliers` are the matches that agree with the pose, None where the method keeps none. `frames` is the support by
    each frame of a query that has several, empty for a single one.
    """

    evidence: Evidence = field(default_factory=Evidence)
    reason: Reason | None = None
    world_from_camera: Pose | None = None
    accuracy: Accuracy | None = None
    accuracy_among: Accuracy | None = None
    confidence: float = 0.0
    keyframes: tuple[KeyframeVote, ...] = ()
    camera: Camera | None = None
    timings_ms: dict[str, float] = field(default_factory=dict)
    candidate: Pose | None = None
    camera_trust: CameraTrust = "confirmed"
    hints: tuple[Hint, ...] = ()
    inliers: Matches | None = None
    frames: tuple[Support, ...] = ()

    @property
    def is_refined(self) -> bool:
        """Whether another camera than the stated one was used."""
        return self.camera_trust == "refined"

    def refused(self, reason: Reason) -> Localization:
        """Return the outcome with its pose refused for a reason."""
        return replace(
            self, reason=reason, world_from_camera=None, accuracy=None, accuracy_among=None, confidence=0.0
        )


def same_place(a: Pose, b: Pose) -> bool:
    """Return whether two `world_from_camera` are near in place and direction."""
    apart_m = float(np.linalg.norm(a.translation - b.translation))
    return apart_m < SAME_PLACE.distance_m and float(a.rotation[:, 2] @ b.rotation[:, 2]) > SAME_PLACE_COSINE


def votes_of(matches: Matches, inliers: Matches) -> tuple[KeyframeVote, ...]:
    """Return the votes of the keyframes behind matches, most inliers first."""
    ids, counts = np.unique(matches.keyframes, return_counts=True)
    agreed = {int(i): int(n) for i, n in zip(*np.unique(inliers.keyframes, return_counts=True), strict=True)}
    votes = [KeyframeVote(int(i), int(n), agreed.get(int(i), 0)) for i, n in zip(ids, counts, strict=True)]
    return tuple(sorted(votes, key=lambda vote: -vote.inliers))


def leading(votes: Sequence[KeyframeVote]) -> list[int]:
    """Return the keyframes of the two votes that come first, whose look-alikes may show another place."""
    return [vote.keyframe for vote in votes[:2]]
