import io
import json
from functools import cache

import numpy as np
import pytest
import shapely
from PIL import Image

from app.geometry.plan import PlanTransform, pixels_from_plan
from bench.demo import VENUE, floor_plans, write_floor_plans
from bench.venue.layout import DOORS, ROOMS
from bench.venue.openings import shared_wall
from bench.venue.venue import DemoFloor
from bench.venue.walkable import free_space


@cache
def floors() -> list[DemoFloor]:
    """Return the floors, which take a second or two to draw."""
    return list(floor_plans())


@pytest.fixture(params=list(VENUE.floors))
def floor(request: pytest.FixtureRequest) -> DemoFloor:
    """Each of the floors."""
    return next(each for each in floors() if each.id == request.param)


def features_of(floor: DemoFloor, kind: str) -> list[dict]:
    return [f for f in floor.features["features"] if f["properties"]["kind"] == kind]


def brightness(floor: DemoFloor, x: float, y: float) -> int:
    """Return the drawing's grey level at a world point of the floor."""
    image = np.asarray(Image.open(io.BytesIO(floor.plan_png)).convert("L"))
    px, py, _ = PlanTransform(floor.plan_from_world).apply([x, y, floor.level * 3.5])
    u, v = pixels_from_plan(px, py, floor.meters_per_pixel, floor.origin_px)
    return int(image[round(float(v)), round(float(u))])


def test_floors_stand_on_each_other():
    assert [floor.id for floor in floors()] == list(VENUE.floors)
    assert floors()[0].z_max_m == floors()[1].z_min_m == 3.5


def test_the_plan_is_turned_and_shifted_differently_on_each_floor():
    yaws = [PlanTransform(floor.plan_from_world).yaw_deg for floor in floors()]
    assert yaws == pytest.approx([90.0, 90.0])
    assert not np.allclose(floors()[0].plan_from_world[:2, 3], floors()[1].plan_from_world[:2, 3])


def test_walls_are_dark_and_doors_are_not(floor):
    for door in DOORS:
        if door.floor != floor.level or door.closed:
            continue
        side, _, line = shared_wall(door)
        beside = door.at_m + door.width_m / 2 + 0.3
        gap, wall = (
            ((door.at_m, line), (beside, line)) if side in "NS" else ((line, door.at_m), (line, beside))
        )
        assert brightness(floor, *gap) > 180, door
        assert brightness(floor, *wall) < 100, door


def test_areas_are_the_rooms_in_plan_metres(floor):
    areas = {f["properties"]["id"]: shapely.geometry.shape(f["geometry"]) for f in features_of(floor, "area")}
    transform = PlanTransform(floor.plan_from_world)
    for room in ROOMS:
        if room.floor == floor.level and room.id != "stair":
            x0, y0, x1, y1 = room.interior
            area = areas[f"area-{room.id}"]
            assert area.area == pytest.approx((x1 - x0) * (y1 - y0), rel=1e-3)
            assert area.contains(shapely.Point(transform.apply([(x0 + x1) / 2, y0 + 0.3, room.base_m])[:2]))


def test_links_join_landmarks_and_keep_clear_of_furniture(floor):
    marks = {f["properties"]["id"]: f["geometry"]["coordinates"] for f in features_of(floor, "landmark")}
    transform = PlanTransform(floor.plan_from_world)
    walks = [f for f in features_of(floor, "link") if f["properties"]["mode"] == "walk"]
    assert len(walks) > 30
    for link in walks:
        properties, path = link["properties"], np.array(link["geometry"]["coordinates"])
        assert np.allclose(path[0], marks[properties["from"]], atol=2e-3)
        assert np.allclose(path[-1], marks[properties["to"]], atol=2e-3)
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert properties["length_m"] == pytest.approx(length, abs=0.05)
        world = transform.apply_inverse(np.column_stack([path, np.zeros(len(path))]))
        outside = shapely.LineString(world[:, :2]).difference(free_space(floor.level).buffer(0.05)).length
        assert outside < 1e-6, properties


def test_stairs_and_lift_join_the_floors():
    for floor, other in (floors(), floors()[::-1]):
        marks = {f["properties"]["id"] for f in features_of(floor, "landmark")}
        others = {f["properties"]["id"] for f in features_of(other, "landmark")}
        up = [f["properties"] for f in features_of(floor, "link") if "to_floor" in f["properties"]]
        assert {link["mode"] for link in up} == {"stairs", "lift"}
        for link in up:
            assert link["to_floor"] == other.id
            assert link["from"] in marks
            assert link["to"] in others


def test_feature_ids_are_unique_and_files_complete(tmp_path):
    manifest = json.loads(write_floor_plans(tmp_path).read_text())
    for entry in manifest["floors"]:
        assert (tmp_path / entry["plan"]).read_bytes().startswith(b"\x89PNG")
        collection = json.loads((tmp_path / entry["features"]).read_text())
        ids = [f["id"] for f in collection["features"]]
        assert len(set(ids)) == len(ids)
