"""Pictures asked with each look, and buildings that differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.engine.progress import NoProgress
from app.engine.query.localizer import Localizer
from app.geometry.se3 import Pose
from bench.evaluation.pose_errors import QueryOutcome
from bench.recordings.queries import DemoQuery
from bench.render.noise import building, seeded
from bench.twins.command import _table
from bench.twins.compare import LOOKS, ONE_LOOK, TWO_LOOKS, WITHOUT_LIMITS, Asked, compare_looks
from bench.twins.recordings import is_twin
from bench.venue.layout import CORRIDORS, ROOMS, Room
from tests.rendered_maps import localizer_of
from tests.scenes import CAMERA, View
from tests.scenes import Room as RenderedRoom


@pytest.fixture(scope="module")
def localizer(views: list[View]) -> Localizer:
    return localizer_of(views[:6])


def picture(folder: Path, view: View) -> DemoQuery:
    path = folder / f"{len(list(folder.iterdir()))}.png"
    cv2.imwrite(str(path), cv2.cvtColor(view.rgb, cv2.COLOR_RGB2BGR))
    return DemoQuery(
        name=path.stem,
        path=path,
        camera=CAMERA,
        world_from_camera=view.world_from_camera,
        room="hall",
        floor=0,
    )


def test_every_look_has_the_outcome_of_every_picture(
    localizer: Localizer, views: list[View], foreign_room: RenderedRoom, tmp_path: Path
) -> None:
    there = picture(tmp_path, views[2])
    gone = picture(tmp_path, foreign_room.view(views[2].world_from_camera))
    found = compare_looks("hall", localizer, [there, gone], NoProgress(), is_absent=False)
    for look in LOOKS:
        assert [outcome.located for outcome in found.outcomes[look]] == [True, False]
        assert found.outcomes[look][0].right


def test_an_answer_for_an_absent_place_is_wrong(
    localizer: Localizer, views: list[View], tmp_path: Path
) -> None:
    found = compare_looks("hall", localizer, [picture(tmp_path, views[2])], NoProgress(), is_absent=True)
    (row,) = {
        tuple(row) for row in zip(*(column.cells for column in _table([found]).columns[2:]), strict=True)
    }
    assert row == ("1", "1", "", "1")


def test_looks_are_counted_apart() -> None:
    right = QueryOutcome(
        name="a",
        located=True,
        position_m=0.1,
        orientation_deg=1.0,
        reason=None,
        inliers=50,
        confidence=0.9,
        milliseconds=1.0,
    )
    wrong, refused = replace(right, position_m=2.0), replace(right, located=False)
    outcomes = {WITHOUT_LIMITS: [right, wrong], ONE_LOOK: [right, refused], TWO_LOOKS: [right, right]}
    table = _table([Asked("hall", False, outcomes)])
    rows = list(zip(*(column.cells for column in table.columns[2:]), strict=True))
    assert rows == [("2", "2", "1", "1"), ("2", "1", "1", "0"), ("2", "2", "2", "0")]


def test_buildings_differ_and_the_first_is_the_demonstration() -> None:
    plain = seeded("poster", 3).random(4)
    with building(0):
        assert np.array_equal(seeded("poster", 3).random(4), plain)
    drawn = []
    for number in (2, 2, 3):
        with building(number):
            drawn.append(seeded("poster", 3).random(4))
    assert np.array_equal(drawn[0], drawn[1])
    assert not np.array_equal(drawn[0], plain)
    assert not np.array_equal(drawn[0], drawn[2])
    assert np.array_equal(seeded("poster", 3).random(4), plain)


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.id)
def test_twins_are_corridors_and_lobbies(room: Room) -> None:
    x0, y0, _, y1 = room.interior
    at = Pose(np.eye(3), np.array([x0 + 0.1, (y0 + y1) / 2, room.base_m + 1.5]))
    assert is_twin(at) == (room.id in {*CORRIDORS, "0-lobby", "1-lobby"})
