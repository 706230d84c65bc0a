"""OpenStreetMap indoor: the same building from XML and GeoJSON, tags and their meaning, hostile documents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from app.errors import InvalidInputError
from app.importers.plans.model import IndoorLevel, IndoorMap
from app.importers.plans.osm.levels import levels_of, orders_of
from app.importers.plans.registry import read_indoor_map
from tests.importers.plans.osm_maps import Drawing, building, write_osm


def of_kind(level: IndoorLevel, kind: str) -> list[dict[str, Any]]:
    return [one for one in level.features["features"] if one["properties"]["kind"] == kind]


def links(level: IndoorLevel) -> dict[str, dict[str, Any]]:
    return {one["properties"]["id"]: one for one in of_kind(level, "link")}


@pytest.fixture(params=["house.osm", "house.geojson"])
def read(request: pytest.FixtureRequest, tmp_path: Path) -> IndoorMap:
    return read_indoor_map(write_osm(tmp_path / request.param, building()))


def test_levels_areas_and_what_is_left_out(read: IndoorMap) -> None:
    assert (read.name, read.format) == ("Town hall", "OpenStreetMap")
    assert [(level.id, level.name, level.order) for level in read.levels] == [
        ("0", "Level 0", 0),
        ("1", "Level 1", 1),
        ("2", "Level 2", 2),
    ]
    areas = [
        {one["properties"]["name"]: one["properties"]["category"] for one in of_kind(level, "area")}
        for level in read.levels
    ]
    assert areas == [
        {"Hall": "area", "101": "office", "Stairs": "room"},
        {"Archive": "room", "Stairs": "room"},
        {"Stairs": "room"},
    ]
    assert read.left_out == {"indoor=furniture": 1, "without level": 2, "other": 1}


def test_a_level_without_lines_gets_links_around_its_walls(read: IndoorMap) -> None:
    ground = read.levels[0]
    names = {one["properties"]["id"] for one in of_kind(ground, "landmark")}
    assert names == {"101", "hall", "west-gate", "vending-machine", "stairs", "lift"} | names
    walks = [
        shapely.LineString(one["geometry"]["coordinates"])
        for one in links(ground).values()
        if "to_floor" not in one["properties"]
    ]
    offset = of_kind(ground, "area")[0]["geometry"]["coordinates"][0][0]
    wall = shapely.LineString([(10, 0), (10, 7)])
    moved = shapely.affinity.translate(wall, *(np.array(offset)[:2]))
    assert len(walks) > 4
    assert not any(line.intersects(moved) for line in walks)
    office = shapely.Polygon(of_kind(ground, "area")[1]["geometry"]["coordinates"][0])
    assert any(line.intersects(office.buffer(-0.1)) for line in walks)


def test_drawn_lines_become_links(read: IndoorMap) -> None:
    upper = links(read.levels[1])
    found = {
        key: value["properties"] for key, value in upper.items() if value["properties"]["mode"] == "walk"
    }
    assert [(one["accessible"], one["one_way"]) for one in found.values() if "accessible" in one] == [
        (False, False)
    ]
    assert [one["one_way"] for one in found.values()] == [False, True]
    assert read.drawn > 0


def test_ways_between_levels(read: IndoorMap) -> None:
    ground, upper = (
        [one["properties"] for one in of_kind(level, "link") if "to_floor" in one["properties"]]
        for level in read.levels[:2]
    )
    assert sorted((way["mode"], way["to_floor"]) for way in ground) == [("lift", "1"), ("stairs", "1")]
    # The escalator goes down, and in that direction alone; the stairwell goes on to level 2.
    assert sorted((way["mode"], way["to_floor"], way.get("one_way")) for way in upper) == [
        ("escalator", "0", True),
        ("stairs", "2", None),
    ]


def test_steps_without_an_incline_begin_where_they_meet_the_level(tmp_path: Path) -> None:
    made = Drawing()
    made.way([(0, 0), (10, 0)], highway="footway", level="0")
    made.way([(20, 0), (30, 0)], highway="footway", level="1")
    made.way([(20, 0), (10, 0)], highway="steps", level="0;1")
    lower, upper = read_indoor_map(write_osm(tmp_path / "steps.osm", made)).levels
    assert [
        one["properties"]["to_floor"]
        for one in links(upper).values()
        if one["properties"]["mode"] == "stairs"
    ] == ["0"]
    assert all(one["properties"]["mode"] == "walk" for one in links(lower).values())


def test_multipolygons_are_areas_with_holes(tmp_path: Path) -> None:
    made = Drawing()
    outer, inner = made.box(0, 0, 20, 20), made.box(8, 8, 4, 4)
    made.relations.append(
        ([(outer, "outer"), (inner, "inner")], {"indoor": "area", "level": "0", "name": "Ring"})
    )
    made.node((1, 1), level="0", name="A")
    made.node((19, 19), level="0", name="B")
    (level,) = read_indoor_map(write_osm(tmp_path / "ring.osm", made)).levels
    (area,) = of_kind(level, "area")
    polygon = shapely.Polygon(area["geometry"]["coordinates"][0], area["geometry"]["coordinates"][1:])
    assert polygon.area == pytest.approx(400 - 16, abs=0.1)
    lines = [shapely.LineString(one["geometry"]["coordinates"]) for one in links(level).values()]
    assert lines
    assert all(polygon.buffer(0.01).covers(line) for line in lines)


def test_names_keep_what_joins_their_letters(tmp_path: Path) -> None:
    name = "کتاب\u200cخانه"
    made = Drawing()
    made.box(0, 0, 5, 5, indoor="room", level="0", name=name)
    made.box(5, 0, 5, 5, indoor="room", level="0", name="\u200b")
    (level,) = read_indoor_map(write_osm(tmp_path / "library.osm", made)).levels
    assert [one["properties"]["name"] for one in of_kind(level, "area")] == [name, "Room"]


def test_levels_between_storeys_and_their_names(tmp_path: Path) -> None:
    made = Drawing()
    for level in ("-1", "0", "0.5", "1"):
        made.box(0, 0, 5, 5, indoor="room", level=level, name=f"Room {level}")
    made.box(-1, -1, 9, 9, indoor="level", level="0.5", name="Mezzanine", **{"level:ref": "M"})
    levels = read_indoor_map(write_osm(tmp_path / "four.osm", made)).levels
    assert [(one.id, one.name, one.order) for one in levels] == [
        ("1", "Level -1", -1),
        ("0", "Level 0", 0),
        ("M", "Mezzanine", 1),
        ("1-2", "Level 1", 2),
    ]


@pytest.mark.parametrize(
    ("tags", "levels"),
    [
        ({"level": "0;1"}, [0, 1]),
        ({"level": "-2--1"}, [-2, -1]),
        ({"level": "-1-2"}, [-1, 0, 1, 2]),
        ({"level": "3", "repeat_on": "4-6;9"}, [3, 4, 5, 6, 9]),
        ({"level": "0.5"}, [0.5]),
        ({"level": "ground"}, []),
        ({"level": "0-999"}, list(range(101))),
        ({"level": "99999"}, []),
        ({}, []),
    ],
)
def test_values_of_level(tags: dict[str, str], levels: list[float]) -> None:
    assert levels_of(tags) == levels


def test_orders_are_whole() -> None:
    assert orders_of([-1.0, 0.0, 2.0]) == {-1.0: -1, 0.0: 0, 2.0: 2}
    assert orders_of([-0.5, 0.0, 0.5]) == {-0.5: -1, 0.0: 0, 0.5: 1}


ENTITIES = """<?xml version="1.0"?><!DOCTYPE osm [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>
<osm><node id="1" lat="48" lon="9"><tag k="level" v="&b;"/></node></osm>"""
OUTSIDE = """<!DOCTYPE osm SYSTEM "file:///etc/passwd"><osm></osm>"""
DAMAGED = {
    "entities": (ENTITIES, "DOCTYPE or entities"),
    "an external document": (OUTSIDE, "DOCTYPE or entities"),
    "entities in UTF-16": (
        ENTITIES.replace("1.0", '1.0" encoding="UTF-16').encode("utf-16"),
        "DOCTYPE or entities",
    ),
    "cut off": ("<osm><node id='1'", "no OSM XML"),
    "no number": ("<osm><node id='1' lat='x' lon='2'/></osm>", "no OSM XML"),
    "NaN for a place": ("<osm><node id='1' lat='nan' lon='2'/></osm>", "no OSM XML"),
    "a tag outside": ("<osm><nd ref='1'/></osm>", "no OSM XML"),
    "no level": ("<osm><node id='1' lat='1' lon='2'><tag k='name' v='a'/></node></osm>", "has a level"),
    "far away": (
        "<osm><node id='1' lat='1' lon='2'><tag k='level' v='0'/></node><node id='2' lat='50' lon='2'>"
        "<tag k='level' v='0'/></node></osm>",
        "100 km",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_hostile_and_damaged_documents_are_refused(tmp_path: Path, case: str) -> None:
    text, hint = DAMAGED[case]
    path = tmp_path / "map.osm"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InvalidInputError, match=hint):
        read_indoor_map(path)


def test_a_room_has_its_landmark_where_a_line_leads_into_it(read: IndoorMap) -> None:
    upper = read.levels[1]
    marks = {one["properties"]["name"]: one["geometry"]["coordinates"] for one in of_kind(upper, "landmark")}
    ends = np.array([links(upper)[key]["geometry"]["coordinates"][-1] for key in ("way/107", "way/108")])
    assert np.allclose([marks["Stairs"], marks["Archive"]], ends)
    assert "End of path" not in marks
