"""Fixes by several anchors together: what agrees, what is contested, and what is exact enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.engine.anchors.anchor import ANYWHERE, Anchor, AnchorSearch, AnchorSpec, AroundPlace
from app.engine.anchors.features import AnchorFeatures
from app.engine.anchors.fix import AnchorFix
from app.engine.anchors.live_anchor import LiveAnchor
from app.engine.anchors.locator import AnchorLocalization, combine_fixes
from app.engine.stage_timer import StageTimer
from app.geometry.camera_hint import hint_of
from app.geometry.se3 import Pose
from app.storage.db import now
from app.vision.features import LocalFeatures
from tests.engine.anchors.test_verification import fix
from tests.scenes import CAMERA

NONE = LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 64), np.float32))


def live(name: str, floor: str = "0") -> LiveAnchor:
    """Return an anchor with a frame that shows nothing."""
    spec = AnchorSpec(
        venue_id="v", floor_id=floor, x=0.0, y=0.0, height_m=2.5, heading_deg=None, camera=hint_of(CAMERA), pois=()
    )  # fmt: skip
    moment = now()
    anchor = Anchor(
        id=name,
        spec=spec,
        calibration=None,
        uses=0,
        last_used_at=None,
        created_at=moment,
        updated_at=moment,
    )
    features = AnchorFeatures(akaze=NONE, xfeat=NONE, words=np.zeros((0, 5), np.int32))
    return LiveAnchor(anchor=anchor, frame="f", camera=CAMERA, features=features, mounted=None)


def at(x: float, *, sigma_m: float = 0.05, inliers: int = 500) -> AnchorFix:
    """Return a fix at a place, with a standard deviation by noise in x and in y."""
    found = fix("gravity", inliers=inliers)
    pose = Pose(np.eye(3), np.array([x, 0.0, 1.5]))
    solution = replace(found.solution, plan_from_phone=pose)
    return replace(found, solution=solution, position_covariance=sigma_m**2 * np.eye(3))


def combined(*fixes: tuple[str, AnchorFix], search: AnchorSearch = ANYWHERE) -> AnchorLocalization:
    """Return the answer by fixes of anchors on these floors."""
    pairs = [(live(f"camera-{number}", floor), one) for number, (floor, one) in enumerate(fixes)]
    return combine_fixes(pairs, 800, StageTimer(), search)


def test_anchors_that_agree_answer_together() -> None:
    found = combined(("0", at(1.0)), ("0", at(1.1)))
    assert found.plan_from_phone is not None
    assert found.anchors == ("camera-0", "camera-1")
    assert 1.0 < found.plan_from_phone.translation[0] < 1.1
    assert not found.is_contested


@pytest.mark.parametrize("floor", ["0", "1"])
def test_two_places_are_contested(floor: str) -> None:
    found = combined(("0", at(1.0)), (floor, at(6.0)))
    assert (found.plan_from_phone, found.reason, found.is_contested) == (None, "ambiguous", True)


def test_an_inexact_fix_elsewhere_contests_a_place_by_its_inliers() -> None:
    assert combined(("0", at(1.0)), ("1", at(6.0, sigma_m=2.0, inliers=300))).is_contested
    assert not combined(("0", at(1.0)), ("1", at(6.0, sigma_m=2.0, inliers=100))).is_contested


def test_an_unstable_fix_with_as_many_inliers_contests_one_that_is_to_be_confirmed() -> None:
    other = at(6.0, sigma_m=2.0, inliers=400)
    unstable = replace(other, evidence=replace(other.evidence, instability_deg=90.0))
    few = replace(unstable, evidence=replace(unstable.evidence, inliers=350))
    first = AnchorSearch(to_be_confirmed=True)
    assert not combined(("0", at(1.0)), ("1", unstable)).is_contested
    assert combined(("0", at(1.0)), ("1", unstable), search=first).is_contested
    assert not combined(("0", at(1.0)), ("1", few), search=first).is_contested


def test_a_fix_that_fails_alone_is_no_contest() -> None:
    found = combined(("0", replace(at(1.0), evidence=replace(at(1.0).evidence, scale_error=0.5))))
    assert (found.reason, found.is_contested) == ("ambiguous", False)


def test_less_exact_fixes_are_accepted_where_they_may_be_rough() -> None:
    rough = at(1.0, sigma_m=0.4)
    assert combined(("0", rough)).reason == "too_few_inliers"
    assert combined(("0", rough), search=AnchorSearch(to_be_confirmed=True)).plan_from_phone is not None


def test_a_search_may_be_rough_around_a_place_or_before_a_second_fix() -> None:
    around = AroundPlace(
        floor_id="0", x=0.0, y=0.0, phone_m=2.0, heading_deg=0.0, half_view_deg=35.0, sees_m=12.0
    )
    assert not AnchorSearch().may_be_rough
    assert AnchorSearch(to_be_confirmed=True).may_be_rough
    assert AnchorSearch(around=around).may_be_rough
    assert AnchorSearch().has_phone(50.0, 0.0)
    assert not AnchorSearch(around=around).has_phone(50.0, 0.0)
