"""Areas and landmarks around a point."""

from __future__ import annotations

import numpy as np

from app.engine.floors.collection import read_collection
from app.engine.floors.model import FloorFeatures
from app.engine.floors.places import PlaceIndex, areas_named, within_areas
from tests.plans import GROUND, area, collection, feature, landmark


def index_of(value: object) -> PlaceIndex:
    return PlaceIndex(read_collection(value, "0")[1])


def test_points_in_and_outside_of_areas() -> None:
    index = index_of(GROUND)
    found = {point: index.area(*point) for point in ((1.0, 3.0), (7.0, 4.0), (5.0, 3.0), (12.0, 6.0))}
    assert [area and area.id for area in found.values()] == ["kitchen", "office", None, "office"]


def test_of_nested_areas_the_smallest_counts() -> None:
    index = index_of(collection(area("hall", 0, 0, 10, 10), area("booth", 4, 4, 6, 6)))
    assert [index.area(x, 5.0).id for x in (3.0, 5.0)] == ["hall", "booth"]  # type: ignore[union-attr]


def test_a_hole_is_not_in_its_area() -> None:
    rings = [[[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]], [[3, 3], [6, 3], [6, 6], [3, 6], [3, 3]]]
    index = index_of(collection(feature("Polygon", rings, kind="area", name="Ring")))
    assert index.area(4.0, 4.0) is None
    assert index.area(1.0, 4.0) is not None


def test_the_nearest_landmark_is_in_the_same_area_if_one_is() -> None:
    index = index_of(GROUND)
    nearest = {point: index.nearest_landmark(*point) for point in ((7.0, 2.2), (1.0, 3.0))}
    assert [found and found.landmark.id for found in nearest.values()] == ["desk", "kitchen-door"]
    assert nearest[7.0, 2.2].distance_m == np.hypot(1, 2.8)  # type: ignore[union-attr]


def test_a_floor_without_features_has_no_places() -> None:
    index = PlaceIndex(FloorFeatures())
    assert index.area(0, 0) is None
    assert index.nearest_landmark(0, 0) is None


def test_an_id_counts_before_a_name() -> None:
    features = read_collection(
        collection(area("a", 0, 0, 1, 1, name="b"), area("b", 2, 0, 3, 1, name="C"), landmark("m", 0, 0)), "0"
    )[1]
    assert [found.id for found in areas_named(features, "b")] == ["b"]
    assert [found.id for found in areas_named(features, " c ")] == ["b"]
    assert areas_named(features, "d") == []


def test_a_margin_around_areas() -> None:
    areas = read_collection(collection(area("a", 0, 0, 2, 2), area("b", 10, 0, 12, 2)), "0")[1].areas
    points = np.array([[1, 1], [4.9, 1], [5.1, 1], [7.5, 1], [11, 1]], dtype=float)
    assert within_areas(points, areas, 3.0).tolist() == [True, True, False, True, True]
