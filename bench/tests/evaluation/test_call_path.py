"""The way of a piece of work through the product's modules."""

from __future__ import annotations

from app.geometry.camera import Camera
from app.geometry.camera_hint import parse_camera_hint
from app.geometry.focal import pinhole
from app.services.locate_result import LocateRequest
from app.services.resources import Resources
from app.services.wiring import wire_services
from app.settings import Settings
from bench.evaluation.call_path import path_of, trace
from tests.scenes import CAMERA_TEXT, View
from tests.server import Server

# It makes 64: a step that is torn in two makes one more, one that is called back from several places many.
MOST_RETURNS = 70


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
