"""Pipelines compared in rooms: every split, variation and pipeline has its figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from rich.table import Table

from app.engine.progress import NoProgress
from app.errors import InvalidInputError
from bench.baselines.plain import PLAIN_NAMES, plain_features
from bench.evaluation.pose_errors import QueryOutcome
from bench.evaluation.variations import VARIATIONS
from bench.figures.shown import report_table
from bench.rooms.compare import OURS, PIPELINES, Comparison, RoomResult, compare_room
from bench.rooms.measured import MeasuredResults
from bench.rooms.rooms import KINDS, ROOMS, Room, RoomSplit, rooms_in
from bench.rooms.tables import rooms_table, splits_table, totals_table
from tests.rendered_maps import models
from tests.scenes import CAMERA, View, scan_files

# Left out of the comparison.
KNOWN = ("hall", "between 0::2 / 1::4", "plain sift", "other-camera")


@pytest.fixture(scope="module")
def data(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one room: fourteen rendered views."""
    folder = tmp_path_factory.mktemp("data")
    for path, content in scan_files(views).items():
        target = folder / "hall" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def results(data: Path) -> list[RoomResult]:
    fx, fy, cx, cy = CAMERA.params[:4]
    room = Room("hall", (RoomSplit("between", "0::2", "1::4"),), {"camera": [fx, fy, cx, cy]})
    variations = [VARIATIONS["none"], VARIATIONS["other-camera"]]
    with ThreadPoolExecutor(1) as executor:
        wanted = Comparison(pipelines=PIPELINES, variations=variations, known={KNOWN})
        return list(compare_room(data, room, wanted, models(), executor, NoProgress()))


def of(results: Sequence[RoomResult], pipeline: str, variation: str) -> RoomResult:
    (found,) = [each for each in results if (each.pipeline, each.variation) == (pipeline, variation)]
    return found


MEASURED = [
    (pipeline, variation)
    for pipeline in PIPELINES
    for variation in ("none", "other-camera")
    if (pipeline, variation) != KNOWN[2:]
]


def test_what_is_known_is_left_out(results: list[RoomResult]) -> None:
    assert [(each.pipeline, each.variation) for each in results] == MEASURED


@pytest.mark.parametrize(("pipeline", "variation"), MEASURED)
def test_every_pipeline_locates_a_clear_view(
    results: list[RoomResult], pipeline: str, variation: str
) -> None:
    found = of(results, pipeline, variation)
    assert (found.room, found.kind, found.split) == ("hall", "between", "between 0::2 / 1::4")
    assert len(found.outcomes) >= 3
    assert found.right == len(found.outcomes)
    assert (found.wrong, found.refused) == (0, 0)
    assert found.median_cm is not None
    assert found.median_cm < 5.0


def test_results_are_read_as_evaluations(results: list[RoomResult]) -> None:
    ours = json.loads(json.dumps(of(results, OURS, "none").as_dict()))
    assert (ours["room"], ours["kind"], ours["variation"]) == ("hall", "between", "none")
    assert [QueryOutcome.from_dict(each).right for each in ours["outcomes"]] == [True] * len(ours["outcomes"])


def test_results_come_back_from_their_file(results: list[RoomResult], tmp_path: Path) -> None:
    path = tmp_path / "rooms.json"
    measured = MeasuredResults.of_file(path)
    assert measured.results == []
    measured.add(results[:2])
    measured.add(results[2:3])
    again = MeasuredResults.of_file(path).results
    assert [each.key for each in again] == [each.key for each in results[:3]]
    assert [each.right for each in again] == [each.right for each in results[:3]]


def test_results_of_another_commit_stay_apart(results: list[RoomResult], tmp_path: Path) -> None:
    path = tmp_path / "rooms.json"
    MeasuredResults(path).add(results[:1], root=tmp_path)
    MeasuredResults.of_file(path, root=tmp_path)
    with pytest.raises(InvalidInputError, match="another commit"):
        MeasuredResults.of_file(path)


def test_tables_say_counts(results: list[RoomResult]) -> None:
    ours = of(results, OURS, "none")
    count = len(ours.outcomes)
    mixed = replace(ours, outcomes=(*ours.outcomes, replace(ours.outcomes[0], located=False)))
    (row,) = cells(splits_table([mixed]))
    assert row[:5] == ["hall", "between 0::2 / 1::4", str(ours.keyframes), "as they are", OURS]
    assert row[5:10] == [str(count + 1), str(count), str(count), str(ours.within_5cm), "0"]
    assert row[10:] == [f"{ours.median_cm:.2f}", "1 of 1"]
    (total,) = cells(totals_table([mixed, ours]))
    assert total[3:] == [
        str(2 * count + 1),
        str(2 * count),
        str(2 * count),
        str(2 * ours.within_5cm),
        "0",
        "1 of 1",
    ]
    assert [row[0] for row in cells(rooms_table(ROOMS))] == [room.folder for room in ROOMS]


def cells(table: Table) -> list[list[str]]:
    return [list(row) for row in report_table(table).rows]


def test_counts_are_of_right_wrong_and_refused(results: list[RoomResult]) -> None:
    ours = of(results, OURS, "none")
    good = ours.outcomes[0]
    wrong = replace(good, position_m=0.6, candidate_m=0.6)
    turned = replace(good, orientation_deg=8.0, candidate_deg=8.0)
    refused = replace(good, located=False, candidate_m=0.1)
    lost = replace(good, located=False, candidate_m=None, candidate_deg=None)
    mixed = replace(ours, outcomes=(good, wrong, turned, refused, lost))
    assert (mixed.right, mixed.wrong, mixed.within_5cm) == (1, 1, 1)
    assert (mixed.refused, mixed.right_refused) == (2, 1)
    assert replace(ours, outcomes=(refused, lost)).median_cm is None


def test_rooms_are_those_that_the_folder_holds(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="holds none"):
        rooms_in(tmp_path, [])
    (tmp_path / "desk_rs").mkdir()
    assert [room.folder for room in rooms_in(tmp_path, [])] == ["desk_rs"]
    with pytest.raises(InvalidInputError, match="no room 'redkitchen'"):
        rooms_in(tmp_path, ["redkitchen"])
    assert {split.kind for room in ROOMS for split in room.splits} == set(KINDS)


def test_splits_are_those_of_the_kinds_asked_for(tmp_path: Path) -> None:
    (tmp_path / "desk_rs").mkdir()
    (room,) = rooms_in(tmp_path, [], ["unseen", "few"])
    assert [split.kind for split in room.splits] == ["unseen", "unseen", "few", "few"]
    with pytest.raises(InvalidInputError, match="'seen' are not known; use between, unseen, few"):
        rooms_in(tmp_path, [], ["seen"])


@pytest.mark.parametrize("name", PLAIN_NAMES)
def test_a_picture_matches_itself(name: str, views: list[View]) -> None:
    features = plain_features(name)  # type: ignore[arg-type]
    found = features.extract(views[3].rgb)
    a, b = features.match(found, found)
    assert found.points_px.shape == (len(found.descriptors), 2)
    assert len(a) > 0.8 * len(found)
    assert (found.points_px[a] == found.points_px[b]).mean() > 0.95
