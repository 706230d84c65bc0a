"""The way of a piece of work through the product's modules."""

from __future__ import annotations

import json
from pathlib import Path

from app.geometry.camera import Camera
from app.geometry.camera_hint import parse_camera_hint
from app.geometry.focal import pinhole
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.wiring import wire_services
from app.settings import Settings
from bench.commands.trace_query import table_of
from bench.evaluation.call_path import path_of, trace
from bench.figures.shown import report_table
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server

# It makes 61: a step that is torn in two makes one more, one that is called back from several places many.
MOST_RETURNS = 62


def test_runs_of_calls_are_stays_and_coming_back_is_a_return() -> None:
    path = path_of(["a", "a", "b", "a", "a", "c", "b"])
    assert path.stays == ("a", "b", "a", "c", "b")
    assert (path.modules, path.returns) == (3, 2)
    assert path_of([]).returns == 0


def test_only_the_products_functions_count() -> None:
    def work() -> Camera:
        return pinhole(640, 480, 500.0)

    assert trace(work).stays == ("geometry/focal", "geometry/camera")


def test_a_query_seldom_comes_back_to_a_module_that_it_left(museum: Server, queries: list[View]) -> None:
    resources = Resources.open(Settings(_env_file=None, data_dir=museum.data_dir, open=True))
    try:
        service = wire_services(resources).locate
        request = LocateRequest(
            image=queries[0].jpeg(), venue="museum", camera=parse_camera_hint(CAMERA_TEXT)
        )
        assert service.locate(request).reason is None
        path = trace(lambda: service.locate(request))
    finally:
        resources.close()
    assert path.modules > 40
    assert path.returns <= MOST_RETURNS, "\n".join(path.stays)


def test_a_table_has_the_returns_of_another_commit_beside(tmp_path: Path) -> None:
    found = {"a.jpg": path_of(["x", "y", "x"]), "new.jpg": path_of(["x"])}
    before = tmp_path / "before.json"
    before.write_text(json.dumps({"commit": "abc1234", "returns": {"a.jpg": 7}}))
    for file, beside in ((None, [[], []]), (before, [["7"], [""]])):
        table = report_table(table_of(found, file))
        counts = [["a.jpg", "2", "3", "1"], ["new.jpg", "1", "1", "0"]]
        assert [list(row) for row in table.rows] == [
            own + more for own, more in zip(counts, beside, strict=True)
        ]
    assert table.columns[-1] == "returns at `abc1234`"
