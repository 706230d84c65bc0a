"""Positioning by anchors: a phone's pose on the plan by the monitoring cameras that see what it sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from app.engine.anchors.anchor import ANYWHERE, AnchorSearch
from app.engine.anchors.features import AnchorDescriber, AnchorFeatures
from app.engine.anchors.fix import AnchorFix
from app.engine.anchors.live_anchor import LiveAnchor
from app.engine.anchors.match_anchor import match_anchor
from app.engine.anchors.matching import likeness
from app.engine.anchors.verification import confidence_of_fix, is_stable, judge_fix
from app.engine.query.placed import Accuracy, Support
from app.engine.query.verification import Reason
from app.engine.stage_timer import StageTimer
from app.geometry.anchor_pose import Vertical
from app.geometry.camera import Camera
from app.geometry.se3 import Pose
from app.limits import limit
from app.vision.images import Rgb, measure_quality, to_gray

Array = NDArray[np.float64]

# Square metres added to the diagonal of a covariance before it is inverted.
COVARIANCE_FLOOR_M2 = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorLocatorOptions:
    """Which anchors an image is matched with, and when their fixes agree."""

    candidates: int = limit(
        6,
        "Largest number of anchors, the most similar by visual words, that are ranked by their likeness.",
        chosen="By hand: of 20 anchors a right one is first by words for 98 % of the phones "
        "(`roomfix evaluate-anchors`; docs/anchors.md, Choosing).",
    )
    matched_anchors: int = limit(
        2,
        "Largest number of these anchors that are matched with all features.",
        chosen="By hand; no measurement is recorded.",
    )
    min_likeness_ratio: float = limit(
        0.6,
        "Least ratio of an anchor's likeness to the highest one for it to be matched after an accepted fix.",
        chosen="By hand; no measurement is recorded.",
    )
    agreement_sigmas: float = limit(
        4.0,
        "Largest distance on the plan of two fixes that agree, divided by its standard deviation.",
        chosen="By hand; no measurement is recorded.",
    )
    rival_inlier_ratio: float = limit(
        0.5,
        "Least ratio of inliers of a stable fix elsewhere to those of the best one; above it the answer is ambiguous.",
        chosen="Recorded walks of roomfix simulate --no-map: of look-alike corridors one was rejected for its sigma "
        "alone; false matches are hardly ever stable.",
    )
    unstable_rival_ratio: float = limit(
        0.75,
        "The same ratio of a fix that isn't stable, where the answer is to be confirmed.",
        chosen="Recorded walks of roomfix simulate --no-map --pois 1 --seed 9: of two corridors that look alike the "
        "right one had 178 inliers, as the wrong one, and was not stable.",
    )
    agreement_m: float = limit(
        0.3,
        "Distance on the plan within which two fixes agree whatever their standard deviations.",
        chosen="By hand; no measurement is recorded.",
    )
    min_image_gravity_ratio: float = limit(
        0.3,
        "Least length of gravity's part in the image plane, divided by its whole length, for a roll.",
        chosen="By hand: a camera that looks nearly straight up or down has no roll.",
    )


OPTIONS = AnchorLocatorOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorLocalization:
    """The outcome for one image; `plan_from_phone` is None exactly when there is a `reason`.

    Positions are in metres on the plan of floor `floor_id`, z is height. `anchors` are the ids of those whose fixes
    agree, `best` is the anchor with the highest confidence and its own fix. `is_contested` says that another place was
    seen as well.
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
    is_contested: bool = False


def locate_by_anchors(
    live: Sequence[LiveAnchor],
    describer: AnchorDescriber,
    rgb: Rgb,
    camera: Camera,
    gravity: Sequence[float] | None,
    timer: StageTimer,
    search: AnchorSearch = ANYWHERE,
) -> AnchorLocalization:
    """Return the pose of an RGB image (height, width, 3) of a camera of that size, by the live anchors.

    `gravity` is down in camera axes; without it the phone is assumed to be upright. The phone is not
    where the `search` says that it can't be.
    """
    if not live:
        return not_located("no_map", timer)
    gray = to_gray(rgb)
    akaze = describer.akaze.extract(gray)
    timer.lap("akaze")
    alike = describer.alike_by_words([anchor.features for anchor in live], akaze)
    order = np.argsort(-alike, kind="stable")
    candidates = [live[int(row)] for row in order[: OPTIONS.candidates]]
    timer.lap("retrieve")
    phone = describer.describe_phone(gray, akaze, roll_deg(gravity))
    timer.lap("describe")
    down = None if gravity is None else np.array(gravity, dtype=np.float64)
    fixes, matches = _fixes(candidates, phone, camera, down, timer, search)
    if not fixes and matches == 0 and measure_quality(gray).is_poor:
        return not_located("poor_image", timer)
    return combine_fixes(fixes, matches, timer, search)


def _fixes(
    candidates: Sequence[LiveAnchor],
    phone: AnchorFeatures,
    camera: Camera,
    gravity: Array | None,
    timer: StageTimer,
    search: AnchorSearch,
) -> tuple[list[tuple[LiveAnchor, AnchorFix]], int]:
    """Return the fixes by the anchors with the highest likeness, and the largest number of matches of an anchor."""
    alike = [likeness(anchor.features, phone) for anchor in candidates]
    timer.lap("rerank")
    found: list[tuple[LiveAnchor, AnchorFix]] = []
    most = 0
    for row in ranked(alike)[: OPTIONS.matched_anchors]:
        accepted = any(judge_fix(fix, search.may_be_rough) is None for _, fix in found)
        # A fix that has to be confirmed may be of a place that looks alike, which the second anchor shows.
        if accepted and not search.to_be_confirmed and alike[row] < OPTIONS.min_likeness_ratio * max(alike):
            break
        live = candidates[row]
        fix, matches = match_anchor(
            live.anchor.spec,
            (live.features, live.camera),
            (phone, camera),
            gravity,
            live.mounted,
            timer,
            live.walls,
        )
        most = max(most, matches)
        if fix is not None and _may_be(fix, search):
            found.append((live, fix))
    return found, most


def _may_be(fix: AnchorFix, search: AnchorSearch) -> bool:
    x, y, _ = fix.solution.plan_from_phone.translation
    return search.has_phone(float(x), float(y))


def ranked(alike: Sequence[int]) -> list[int]:
    """Return the rows of anchors by decreasing likeness; equal ones keep their order."""
    return sorted(range(len(alike)), key=lambda row: -alike[row])


def roll_deg(gravity: Sequence[float] | None) -> float:
    """Return the counter-clockwise rotation in degrees that makes an image upright, by down (3,) in camera axes.

    It is 0 when gravity is not known, or when the camera looks nearly straight up or down.
    """
    if gravity is None:
        return 0.0
    if np.hypot(gravity[0], gravity[1]) < OPTIONS.min_image_gravity_ratio * np.linalg.norm(gravity):
        return 0.0
    # Down is along +v in an upright image, and along -u in one whose lower edge is on the left.
    return float(np.degrees(np.arctan2(-gravity[0], gravity[1])))


def combine_fixes(
    fixes: Sequence[tuple[LiveAnchor, AnchorFix]],
    matches: int,
    timer: StageTimer,
    search: AnchorSearch = ANYWHERE,
) -> AnchorLocalization:
    """Return the answer by all fixes that are accepted and agree; `matches` is stated where there is none."""
    judged = [(anchor, fix, judge_fix(fix, search.may_be_rough)) for anchor, fix in fixes]
    accepted = [(anchor, fix) for anchor, fix, reason in judged if reason is None]
    if not accepted:
        reasons = [reason for _, _, reason in judged if reason is not None]
        return not_located(
            "ambiguous" if "ambiguous" in reasons else "too_few_inliers" if reasons else "no_match",
            timer,
            matches,
        )
    accepted.sort(key=lambda pair: -confidence_of_fix(pair[1]))
    anchor, best = accepted[0]
    agreeing = [pair for pair in accepted if _agree(anchor, best, *pair)]
    rivals = [pair for pair in fixes if not _agree(anchor, best, *pair) and _rivals(best, pair[1], search)]
    if len(agreeing) < len(accepted) or rivals:
        return replace(not_located("ambiguous", timer, matches), is_contested=True)
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


def not_located(reason: Reason, timer: StageTimer, matches: int = 0) -> AnchorLocalization:
    """Return the outcome for an image that can't be located."""
    return AnchorLocalization(reason=reason, support=Support(matches=matches), timings_ms=timer.milliseconds)


def _agree(one: LiveAnchor, a: AnchorFix, other: LiveAnchor, b: AnchorFix) -> bool:
    if one.anchor.spec.floor_id != other.anchor.spec.floor_id:
        return False
    difference = (a.solution.plan_from_phone.translation - b.solution.plan_from_phone.translation)[:2]
    sigma = float(np.hypot(a.noise_sigma_m, b.noise_sigma_m))
    return float(np.linalg.norm(difference)) <= max(OPTIONS.agreement_sigmas * sigma, OPTIONS.agreement_m)


def _rivals(best: AnchorFix, other: AnchorFix, search: AnchorSearch) -> bool:
    """Whether a fix elsewhere, not exact enough itself, has so many inliers that the two places look alike."""
    share = other.evidence.inliers / max(best.evidence.inliers, 1)
    # A first fix can wait, so that it needs more than to be the steadier one of two.
    is_as_likely = search.to_be_confirmed and share >= OPTIONS.unstable_rival_ratio
    return is_as_likely or (share >= OPTIONS.rival_inlier_ratio and is_stable(other.evidence))


def _joined(fixes: Sequence[AnchorFix]) -> tuple[Pose, Array]:
    """Return the mean of positions weighted by their inverse covariances, and its covariance.

    The rotation is that of the fix with the smallest standard deviation of the attitude.
    """
    best = min(fixes, key=lambda fix: fix.orientation_sigma_deg)
    floor = COVARIANCE_FLOOR_M2 * np.eye(3)
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
