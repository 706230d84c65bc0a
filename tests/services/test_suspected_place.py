"""Where a refused picture seems to have been taken, as operators count it."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from app.api.metrics import Metrics
from app.engine.floors.plan_point import PlanPoint
from app.engine.query.localization import Localization
from app.engine.query.verification import Evidence, Limits, Reason
from app.services.locate_result import LocateRequest, LocateResult, Suspected, map_result
from app.storage.maps import MapVersion
from tests.plans import IN_WORLD
from tests.scenes import CAMERA, pose_at

VERSION = cast(MapVersion, SimpleNamespace(version=1, z_up=True, has_scale=True, plan_reason=None))
MOST = Limits().max_contradicted_share_of_twin
HERE = pose_at(1.0, 2.0, 1.5, 0.0, 0.0)


def result_of(
    reason: Reason | None, contradicted: float = 0.0, version: MapVersion = VERSION
) -> LocateResult:
    found = Localization(
        evidence=Evidence(contradicted=contradicted),
        reason=reason,
        world_from_camera=None if reason else HERE,
        candidate=HERE,
        camera=CAMERA,
    )
    camera = cast(Any, SimpleNamespace(camera=CAMERA, likely=CAMERA, source_of=lambda _: "request"))
    return map_result("house", version, found, False, [IN_WORLD], LocateRequest(image=b""), camera)


def counted(result: LocateResult) -> dict[str, str]:
    """Return the counters by area that hold one query, without their venue and floor."""
    metrics = Metrics()
    metrics.observe_query(result)
    text = metrics.render().decode()
    return dict(re.findall(r"^roomfix_locate_(area|contradicted)_total\{(.*)\} 1.0$", text, re.MULTILINE))


def test_an_ambiguous_picture_counts_where_its_best_pose_is() -> None:
    found = result_of("ambiguous")
    assert found.world_from_camera is None
    assert found.suspected is not None
    assert found.suspected.plan is not None
    assert (found.suspected.plan.x, found.suspected.plan.y) == (1.0, 2.0)
    named = replace(found.suspected.plan, area="hall")
    hall = replace(found, suspected=Suspected(IN_WORLD, named))
    assert counted(hall) == {"area": 'area="hall",floor="0",outcome="ambiguous",venue="house"'}


@pytest.mark.parametrize("reason", ["no_match", "too_few_inliers", "poor_image"])
def test_a_pose_for_which_too_little_speaks_is_no_place(reason: Reason) -> None:
    found = result_of(reason)
    assert found.suspected is None
    assert counted(found) == {"area": f'area="",floor="",outcome="{reason}",venue="house"'}


def test_without_up_only_the_floor_is_known() -> None:
    leaning = cast(MapVersion, SimpleNamespace(**{**vars(VERSION), "z_up": False}))
    assert result_of("ambiguous", version=leaning).suspected == Suspected(IN_WORLD, None)


@pytest.mark.parametrize("reason", [None, "ambiguous"])
def test_pictures_that_the_map_contradicts_are_counted_located_or_not(reason: Reason | None) -> None:
    assert not result_of(reason, MOST).contradicted
    found = result_of(reason, MOST + 0.01)
    assert found.contradicted
    where = 'area="",floor="0"'
    assert counted(found) == {
        "area": f'{where},outcome="{reason or "located"}",venue="house"',
        "contradicted": f'{where},venue="house"',
    }


def test_a_located_picture_counts_where_it_is() -> None:
    found = result_of(None)
    assert (found.suspected, found.floor) == (None, IN_WORLD)
    assert isinstance(found.plan, PlanPoint)
    hall = replace(found, plan=replace(found.plan, area="hall"))
    assert counted(hall)["area"] == 'area="hall",floor="0",outcome="located",venue="house"'


def test_what_no_map_was_asked_for_is_in_no_area() -> None:
    """A session's frame has a place by the way that the phone went, whatever the map says of its picture."""
    assert counted(replace(result_of(None, MOST + 0.01), contradicted=None)) == {}
