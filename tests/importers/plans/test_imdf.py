"""IMDF as other programs write it: what becomes what, links from shapes, and archives that are damaged."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from app.errors import InvalidInputError
from app.importers.plans.model import IndoorLevel, IndoorMap
from app.importers.plans.registry import read_indoor_map
from tests.importers.plans.imdf_maps import (
    FRAME,
    GROUND,
    UPPER,
    box,
    entry,
    features,
    point,
    positions,
    write_imdf,
)


def of_kind(level: IndoorLevel, kind: str) -> list[dict[str, Any]]:
    return [one for one in level.features["features"] if one["properties"]["kind"] == kind]


def names(level: IndoorLevel, kind: str) -> dict[str, str]:
    return {one["properties"]["id"]: one["properties"]["name"] for one in of_kind(level, kind)}


@pytest.fixture
def read(tmp_path: Path) -> IndoorMap:
    return read_indoor_map(write_imdf(tmp_path / "house.zip", features()))


def test_levels_become_floors_with_short_names_and_labels_in_the_archives_language(read: IndoorMap) -> None:
    assert (read.name, read.format) == ("Haus", "IMDF")
    assert [(level.id, level.name, level.order) for level in read.levels] == [
        ("0", "Erdgeschoss", 0),
        ("OG-1", "Obergeschoss", 1),
    ]
    assert read.origin == pytest.approx((FRAME.longitude, FRAME.latitude))


def test_units_become_areas_with_their_category(read: IndoorMap) -> None:
    areas = {one["properties"]["id"]: one["properties"] for one in of_kind(read.levels[0], "area")}
    assert {key: value["category"] for key, value in areas.items()} == {
        "g-corridor": "walkway",
        "g-office": "office",
        "g-store": "nonpublic",
        "g-stairs": "stairs",
        "g-lift": "elevator",
    }
    assert areas["g-office"]["name"] == "Office g (de)"
    assert areas["g-corridor"]["name"] == "Walkway"
    outline = of_kind(read.levels[0], "area")[1]["geometry"]["coordinates"][0]
    assert np.ptp(outline, axis=0) == pytest.approx([8, 6], abs=1e-3)


def test_what_people_look_for_becomes_landmarks(read: IndoorMap) -> None:
    ground, upper = (names(level, "landmark") for level in read.levels)
    # The occupant at its anchor is the office's landmark; the store is not public.
    assert ground == {
        "praxis": "Praxis",
        "kiosk": "Kiosk",
        "stairs": "Stairs",
        "lift": "Lift",
        "entrance": "Entrance",
    }
    assert upper == {
        "vendingmachine": "Vendingmachine",
        "office-u-de": "Office u (de)",
        "stairs": "Stairs",
        "lift": "Lift",
    }


def test_what_is_left_out_is_counted(read: IndoorMap) -> None:
    assert read.left_out == {
        "amenity": 1,
        "detail": 1,
        "fixture": 3,
        "relationship": 1,
        "unit (column)": 2,
    }


def test_links_stay_in_rooms_and_doors(read: IndoorMap) -> None:
    for level in read.levels:
        units = {
            one["properties"]["id"][2:]: shapely.Polygon(one["geometry"]["coordinates"][0])
            for one in of_kind(level, "area")
        }
        walkable = shapely.union_all([units[key] for key in ("corridor", "office", "stairs", "lift")]).buffer(
            0.01
        )
        walls = units["office"].boundary.difference(shapely.LineString([(3.5, 2), (4.5, 2)]).buffer(0.01))
        pillar = shapely.box(10, 0.9, 10.3, 1.2)
        links = [
            shapely.LineString(one["geometry"]["coordinates"])
            for one in of_kind(level, "link")
            if "to_floor" not in one["properties"]
        ]
        assert links
        for line in links:
            assert walkable.covers(line)
            assert not line.crosses(walls)
            assert not line.intersects(pillar)
    assert read.drawn == read.paths - 2 > 0


def test_stacked_units_become_ways(read: IndoorMap) -> None:
    ways = [one["properties"] for one in of_kind(read.levels[0], "link") if "to_floor" in one["properties"]]
    assert [(way["mode"], way["from"], way["to"], way["to_floor"]) for way in ways] == [
        ("stairs", "stairs", "stairs", "OG-1"),
        ("lift", "lift", "lift", "OG-1"),
    ]


def test_a_lift_joins_every_pair_of_its_levels(tmp_path: Path) -> None:
    types = features()
    third = "00000000-0000-4000-8000-000000000003"
    types["level"].append(
        entry("level", third, box(-1, -1, 27, 14), ordinal=2, name={"de": "Dach"}, short_name=None)
    )
    types["unit"].append(entry("unit", "r-lift", box(12, 2, 2, 2), category="elevator", level_id=third))
    levels = read_indoor_map(write_imdf(tmp_path / "map", types)).levels
    lifts = [
        (level.id, one["properties"]["to_floor"])
        for level in levels
        for one in of_kind(level, "link")
        if one["properties"]["mode"] == "lift"
    ]
    assert lifts == [("0", "OG-1"), ("0", "2"), ("OG-1", "2")]


def test_relationships_with_a_line_are_links_and_nothing_is_made_from_shapes(tmp_path: Path) -> None:
    types = features()
    line = {"type": "LineString", "coordinates": positions((1, 1), (21, 1), (21, 11))}
    here = {"id": "g-corridor", "feature_type": "unit"}
    types["relationship"] = [
        entry(
            "relationship",
            "w",
            line,
            category="traversal.path",
            direction="directed",
            origin=here,
            destination=here,
        ),
        entry(
            "relationship",
            "e",
            None,
            category="escalator",
            direction="directed",
            origin={"id": "u-stairs", "feature_type": "unit"},
            intermediary=None,
            destination={"id": "g-stairs", "feature_type": "unit"},
        ),
    ]
    ground, upper = read_indoor_map(write_imdf(tmp_path / "map", types)).levels
    walks = [one for one in of_kind(ground, "link") if one["properties"]["mode"] == "walk"]
    assert len(walks) == 1
    assert walks[0]["properties"]["one_way"] is True
    assert np.allclose(walks[0]["geometry"]["coordinates"], [(1, 1), (21, 1), (21, 11)], atol=1e-3)
    # Loose ends get landmarks, so that nothing dangles.
    assert "end-of-path" in names(ground, "landmark")
    down = [one["properties"] for one in of_kind(upper, "link") if one["properties"]["mode"] == "escalator"]
    assert [(way["to_floor"], way["one_way"]) for way in down] == [("0", True)]


def test_outlines_that_cross_themselves_are_mended(tmp_path: Path) -> None:
    types = features()
    bow = positions((30, 0), (34, 4), (34, 0), (30, 4), (30, 0))
    types["unit"].append(
        entry("unit", "bow", {"type": "Polygon", "coordinates": [bow]}, category="room", level_id=GROUND)
    )
    found = names(read_indoor_map(write_imdf(tmp_path / "map", types)).levels[0], "area")
    assert {"bow", "bow-2"} <= found.keys()


def test_two_buildings_of_one_ordinal_share_a_floor(tmp_path: Path) -> None:
    types = features()
    outside = "00000000-0000-4000-8000-000000000009"
    types["level"].append(
        entry(
            "level",
            outside,
            box(-50, -50, 40, 40),
            ordinal=0,
            outdoor=True,
            name={"de": "Hof"},
            short_name={"de": "H"},
        )
    )
    types["unit"].append(entry("unit", "yard", box(-50, -50, 40, 40), category="walkway", level_id=outside))
    levels = read_indoor_map(write_imdf(tmp_path / "map", types)).levels
    assert [(level.id, level.name) for level in levels] == [("0", "Erdgeschoss"), ("OG-1", "Obergeschoss")]
    assert "yard" in names(levels[0], "area")


DAMAGED: dict[str, tuple[str, Any, str]] = {
    "no levels": ("level", [], "no level"),
    "an ordinal of text": ("level", [entry("level", "x", None, ordinal="a")], "ordinal"),
    "an ordinal that is no number": ("level", [entry("level", "x", None, ordinal="x")], "ordinal"),
    "a number that is none": (
        "level",
        [entry("level", "x", None, ordinal=float("nan"))],
        "level.geojson is not JSON",
    ),
    "features of text": ("unit", ["a"], "FeatureCollection"),
    "a unit without outline": ("unit", [entry("unit", "x", None, level_id=GROUND)], "Unit x needs a Polygon"),
    "a unit of two points": (
        "unit",
        [
            entry(
                "unit",
                "x",
                {"type": "Polygon", "coordinates": [positions((0, 0), (1, 0), (0, 0))]},
                level_id=GROUND,
            )
        ],
        "fewer than three",
    ),
    "coordinates of text": (
        "unit",
        [entry("unit", "x", {"type": "Polygon", "coordinates": [[["a", "b"]]]}, level_id=GROUND)],
        "no valid coordinates",
    ),
    "a place elsewhere": (
        "amenity",
        [entry("amenity", "x", {"type": "Point", "coordinates": [90, 10]}, unit_ids=["g-office"])],
        "100 km",
    ),
    "degrees that are none": (
        "amenity",
        [entry("amenity", "x", {"type": "Point", "coordinates": [900, 10]}, unit_ids=["g-office"])],
        "180",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_archives_are_refused_with_a_reason(tmp_path: Path, case: str) -> None:
    kind, entries, hint = DAMAGED[case]
    with pytest.raises(InvalidInputError, match=hint):
        read_indoor_map(write_imdf(tmp_path / "map", {**features(), kind: entries}))


def test_a_zip_that_is_cut_off_or_larger_than_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write_imdf(tmp_path / "map.zip", features())
    (tmp_path / "cut.zip").write_bytes(whole.read_bytes()[:-400])
    with pytest.raises(InvalidInputError, match="no zip"):
        read_indoor_map(tmp_path / "cut.zip")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("level.geojson", b" " * 210_000_000)
    with pytest.raises(InvalidInputError, match="200,000,000"):
        read_indoor_map(tmp_path / "bomb.zip")


def test_files_of_no_known_format_are_named(tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "notes.json").write_text("{}")
    with pytest.raises(InvalidInputError, match=r"notes\.json, which is no indoor map"):
        read_indoor_map(tmp_path / "map")
    with pytest.raises(InvalidInputError, match="wrld, imdf"):
        read_indoor_map(tmp_path / "map", "dwg")


def test_points_of_the_fixture_are_what_they_say() -> None:
    assert FRAME.plan_from_geodetic([point(3, 4)["coordinates"]]).tolist() == [[3.0, 4.0]]
    assert UPPER != GROUND
