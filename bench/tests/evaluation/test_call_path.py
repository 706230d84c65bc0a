"""The way of a piece of work through the product's modules."""

from __future__ import annotations

from app.geometry.camera import Camera
from app.geometry.focal import pinhole
from bench.evaluation.call_path import path_of, trace


def test_runs_of_calls_are_stays_and_coming_back_is_a_return() -> None:
    path = path_of(["a", "a", "b", "a", "a", "c", "b"])
    assert path.stays == ("a", "b", "a", "c", "b")
    assert (path.modules, path.returns) == (3, 2)
    assert path_of([]).returns == 0


def test_only_the_products_functions_count() -> None:
    def work() -> Camera:
        return pinhole(640, 480, 500.0)

    assert trace(work).stays == ("geometry/focal", "geometry/camera")
