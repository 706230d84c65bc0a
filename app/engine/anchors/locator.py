"""Positioning by anchors: the monitoring cameras that see what the phone sees, and where that puts the phone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.features import NO_WORDS, AnchorDescriber, AnchorFeatures, likeness
from app.engine.anchors.fix import AnchorFix
from app.engine.anchors.live_anchor import LiveAnchor
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.verification import confidence_of_fix, judge_fix
from app.engine.query.placed import Accuracy, Support
from app.engine.query.verification import Reason
from app.engine.stage_timer import StageTimer
from app.geometry.anchor_pose import Vertical
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.vision.images import Rgb, measure_quality, to_gray

Array = NDArray[np.float64]

# So many anchors, by visual words, are compared with the picture; of these the most alike get a close look.
CANDIDATES, CLOSE_LOOKS = 6, 2
# After a good answer another anchor gets a close look only when it is this share as alike as the first.
NEARLY_AS_ALIKE = 0.6
# Two anchors agree when their answers differ by no more than this many sigma, or this many metres.
AGREEMENT_SIGMAS, AGREEMENT_M = 4.0, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorLocalization:
    """The outcome for one picture. `plan_from_phone` is None exactly when `reason` says why.

    Positions are metres on the plan of floor `floor_id`, and height; `anchors` are those that agree on it, `best` the
    one that is surest, with its own answer.
    """

    plan_from_phone: Pose | None = None
    reason: Reason | None = None
    floor_id: str | None = None
    anchors: tuple[str, ...] = ()
    vertical: Vertical | None = None
    confidence: float = 0.0
    accuracy: Accuracy | None = None
    support: Support = Support()
    timings_ms: dict[str, float] = field(default_factory=dict)
    best: tuple[LiveAnchor, AnchorFix] | None = None


def locate_by_anchors(
    live: Sequence[LiveAnchor],
    describer: AnchorDescriber,
    rgb: Rgb,
    camera: Camera,
    gravity: Sequence[float] | None,
    timer: StageTimer,
) -> AnchorLocalization:
    """Return where an RGB image (height, width, 3) of a camera of that size was taken, by the anchors that are live.

    `gravity` is down in camera axes; without it the phone is taken to be upright.
    """
    if not live:
        return _nothing("no_map", timer)
    gray = to_gray(rgb)
    akaze = describer.akaze.extract(gray)
    timer.lap("akaze")
    alike = describer.alike_by_words([anchor.features for anchor in live], akaze)
    order = np.argsort(-alike, kind="stable")
    candidates = [live[int(row)] for row in order[:CANDIDATES]]
    timer.lap("retrieve")
    phone = AnchorFeatures(
        akaze=akaze, xfeat=describer.upright_xfeat(gray, roll_deg(gravity)), words=NO_WORDS
    )
    timer.lap("describe")
    down = None if gravity is None else np.array(gravity, dtype=np.float64)
    fixes, matched = _fixes(candidates, phone, camera, down, timer)
    if not fixes and matched == 0 and measure_quality(gray).is_poor:
        return _nothing("poor_image", timer)
    return conclude(fixes, matched, timer)


def _fixes(
    candidates: Sequence[LiveAnchor],
    phone: AnchorFeatures,
    camera: Camera,
    gravity: Array | None,
    timer: StageTimer,
) -> tuple[list[tuple[LiveAnchor, AnchorFix]], int]:
    """Return the answers of the anchors that look most like the picture, and the most matches of any."""
    alike = [likeness(anchor.features, phone) for anchor in candidates]
    timer.lap("rerank")
    found: list[tuple[LiveAnchor, AnchorFix]] = []
    most = 0
    for row in ranked(alike)[:CLOSE_LOOKS]:
        good = any(judge_fix(fix) is None for _, fix in found)
        if good and alike[row] < NEARLY_AS_ALIKE * max(alike):
            break
        live = candidates[row]
        fix, matched = match_anchor(
            live.anchor.spec,
            (live.features, live.camera),
            (phone, camera),
            gravity,
            live.mounted,
            timer,
        )
        most = max(most, matched)
        if fix is not None:
            found.append((live, fix))
    return found, most


def ranked(alike: Sequence[int]) -> list[int]:
    """Return the anchors' numbers, most alike first, those equally alike in the order given."""
    return sorted(range(len(alike)), key=lambda row: -alike[row])


def roll_deg(gravity: Sequence[float] | None) -> float:
    """Return by how many degrees a picture must be turned counter-clockwise to be upright, by down (3,) in camera
    axes; 0 when that isn't known, or the camera looks nearly straight up or down."""
    if gravity is None or np.hypot(gravity[0], gravity[1]) < 0.3 * np.linalg.norm(gravity):
        return 0.0
    # Down points along +v in an upright picture; in one whose lower edge is on the left, along -u.
    return float(np.degrees(np.arctan2(-gravity[0], gravity[1])))


def conclude(
    fixes: Sequence[tuple[LiveAnchor, AnchorFix]], matched: int, timer: StageTimer
) -> AnchorLocalization:
    """Return the answer that the anchors' answers amount to."""
    judged = [(anchor, fix, judge_fix(fix)) for anchor, fix in fixes]
    good = [(anchor, fix) for anchor, fix, reason in judged if reason is None]
    if not good:
        reasons = [reason for _, _, reason in judged if reason is not None]
        return _nothing(
            "ambiguous" if "ambiguous" in reasons else "too_few_inliers" if reasons else "no_match",
            timer,
            matched,
        )
    good.sort(key=lambda pair: -confidence_of_fix(pair[1]))
    anchor, best = good[0]
    agreeing = [pair for pair in good if _agree(anchor, best, *pair)]
    if len(agreeing) < len(good):
        return _nothing("ambiguous", timer, matched)
    pose, covariance = _joined([fix for _, fix in agreeing])
    timer.lap("pose")
    return AnchorLocalization(
        plan_from_phone=pose,
        floor_id=anchor.anchor.spec.floor_id,
        anchors=tuple(live.anchor.id for live, _ in agreeing),
        vertical=best.solution.vertical,
        accuracy=Accuracy(
            float(np.sqrt(np.trace(covariance[:2, :2]))),
            min(fix.orientation_sigma_deg for _, fix in agreeing),
        ),
        confidence=max(confidence_of_fix(fix) for _, fix in agreeing),
        support=Support(
            sum(fix.evidence.inliers for _, fix in agreeing), sum(fix.evidence.matches for _, fix in agreeing)
        ),
        timings_ms=timer.milliseconds,
        best=(anchor, best),
    )


def _nothing(reason: Reason, timer: StageTimer, matches: int = 0) -> AnchorLocalization:
    return AnchorLocalization(reason=reason, support=Support(matches=matches), timings_ms=timer.milliseconds)


def _agree(one: LiveAnchor, a: AnchorFix, other: LiveAnchor, b: AnchorFix) -> bool:
    if one.anchor.spec.floor_id != other.anchor.spec.floor_id:
        return False
    apart = (a.solution.plan_from_phone.translation - b.solution.plan_from_phone.translation)[:2]
    sigma = float(np.hypot(a.noise_sigma_m, b.noise_sigma_m))
    return float(np.linalg.norm(apart)) <= max(AGREEMENT_SIGMAS * sigma, AGREEMENT_M)


def _joined(fixes: Sequence[AnchorFix]) -> tuple[Pose, Array]:
    """Return the least-squares middle of positions by their covariances, with the most certain one's rotation."""
    best = min(fixes, key=lambda fix: fix.orientation_sigma_deg)
    floor = 1e-6 * np.eye(3)
    information = [np.linalg.inv(fix.full_covariance + floor) for fix in fixes]
    covariance = np.linalg.inv(sum(information, np.zeros((3, 3))))
    weighted = sum(
        (
            weight @ fix.solution.plan_from_phone.translation
            for weight, fix in zip(information, fixes, strict=True)
        ),
        np.zeros(3),
    )
    return Pose(best.solution.plan_from_phone.rotation, covariance @ weighted), covariance
