"""A venue as an IMDF archive: it has the format's structure, stays the same, and reads back as it was."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from app.cli import app as cli
from app.commands.export_plan import frame_of
from app.engine.floors.earth import VenueOrigin
from app.errors import InvalidInputError, NotFoundError
from app.importers.plans.imdf import names
from app.services.floor_features import store_features
from app.services.plans.earth_geojson import venue_geojson
from app.services.plans.export_plan import ImdfDetails, export_imdf
from app.services.resources import Resources
from app.settings import Settings
from app.storage.floors import put_floor
from app.storage.venues import create_venue, place_venue
from tests.services.plans.venues import (
    SOMEWHERE,
    assert_same_features,
    assert_same_routes,
    features_of,
    floors_of,
    round_trip,
)

UUID_4 = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}")
# Per feature type: the type of geometry, the members that must not be null, and those that may be.
STRUCTURE: dict[str, tuple[set[str | None], set[str], set[str]]] = {
    "address": (
        {None},
        {"address", "locality", "country"},
        {"unit", "province", "postal_code", "postal_code_ext", "postal_code_vanity"},
    ),
    "venue": (
        {"Polygon"},
        {"category", "name", "display_point", "address_id"},
        {"restriction", "alt_name", "hours", "website", "phone"},
    ),
    "building": ({None}, {"category"}, {"name", "alt_name", "restriction", "display_point", "address_id"}),
    "footprint": ({"Polygon"}, {"category", "building_ids"}, {"name"}),
    "level": (
        {"Polygon"},
        {"category", "outdoor", "ordinal", "name", "short_name"},
        {"restriction", "display_point", "address_id", "building_ids"},
    ),
    "unit": (
        {"Polygon", "MultiPolygon"},
        {"category", "level_id"},
        {"restriction", "accessibility", "name", "alt_name", "display_point"},
    ),
    "amenity": (
        {"Point"},
        {"category", "unit_ids"},
        {
            "accessibility", "name", "alt_name", "hours", "phone", "website", "address_id", "correlation_id",
        },
    ),
    "relationship": (
        {"LineString", "Point"},
        {"category", "direction"},
        {"origin", "intermediary", "destination", "hours"},
    ),
}  # fmt: skip


@pytest.fixture
def resources(tmp_path: Path) -> Iterator[Resources]:
    opened = Resources.open(Settings(_env_file=None, data_dir=tmp_path / "data", open=True))
    yield opened
    opened.close()


def one(kind: str, own: str, geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    shape = {"type": geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": shape, "properties": {"kind": kind, "id": own, **properties}}


HALL = [[[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]], [[8, 4], [8, 6], [12, 6], [12, 4], [8, 4]]]
GROUND = [
    one("area", "hall", "Polygon", HALL, name="Hälle „Süd“", category="sales", colour={"fill": [1, 2]}),
    one(
        "area",
        "stairs",
        "Polygon",
        [[[20, 0], [24, 0], [24, 4], [20, 4], [20, 0]]],
        name="Steps",
        category="stairs",
    ),
    one("landmark", "door", "Point", [0, 5], name="Door", since=2024),
    one("landmark", "yard", "Point", [-6, 5], name="Yard"),
    one("poi", "till", "Point", [10, 8], name="Till"),
    one("link", "in", "LineString", [[-6, 5], [0, 5]], one_way=True, **{"from": "yard", "to": "door"}),
    one("link", "out", "LineString", [[0, 5], [4, 8], [-6, 5]], one_way=True, accessible=False, name="Back"),
    one("link", "main", "LineString", [[0, 5], [10, 8], [22, 2]], length_m=25.0),
    one("link", "up", "LineString", [[22, 2], [23, 3]], mode="stairs", to_floor="1", one_way=True),
    one("link", "lift", "Point", [10, 8], mode="lift", to_floor="1", to="landing", length_m=9.0),
]
UPPER = [
    one("landmark", "landing", "Point", [10.25, 8.5], name="Landing"),
    one("link", "walk", "LineString", [[10.25, 8.5], [23, 3]]),
    one("link", "down", "LineString", [[23, 3], [22, 2]], mode="escalator", to_floor="0"),
]


def make_venue(resources: Resources, venue: str = "shop") -> None:
    with resources.database.write() as connection:
        create_venue(connection, venue, "Kaufhaus 百貨")
        for floor_id, level in (("0", 0), ("1", 1), ("roof", 2)):
            put_floor(
                connection,
                venue,
                floor_id,
                name=f"Level {floor_id}",
                level=level,
                z_min_m=4.0 * level,
                z_max_m=4.0 * level + 3.1,
                plan_from_world=None,
                plan_residual_m=None,
            )
    for floor_id, features in (("0", GROUND), ("1", UPPER)):
        store_features(resources, venue, floor_id, {"type": "FeatureCollection", "features": features})


def contents(archive: Path) -> dict[str, Any]:
    with zipfile.ZipFile(archive) as opened:
        return {name: json.loads(opened.read(name)) for name in opened.namelist()}


def test_a_venue_comes_back_the_same(resources: Resources, tmp_path: Path) -> None:
    make_venue(resources)
    round_trip(resources, "shop", tmp_path, "again")
    assert assert_same_features(resources, "shop", "again") == len(GROUND) + len(UPPER)
    assert assert_same_routes(resources, "shop", "again") == 3
    assert [floor[0] for floor in floors_of(resources, "again")] == ["0", "1", "roof"]
    assert features_of(resources, "again", "0")["area", "hall"]["properties"]["colour"] == {"fill": [1, 2]}


def test_the_archive_has_the_structure_of_the_format(resources: Resources, tmp_path: Path) -> None:
    make_venue(resources)
    files = contents(round_trip(resources, "shop", tmp_path, "again"))
    manifest = files.pop("manifest.json")
    assert manifest["version"] == "1.0.0"
    assert manifest["extensions"] == [names.EXTENSION]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", manifest["created"])
    by_id: dict[str, str] = {}
    for name, collection in files.items():
        kind = name.removesuffix(".geojson")
        assert collection["type"] == "FeatureCollection"
        for feature in collection["features"]:
            check_feature(kind, feature)
            assert feature["id"] not in by_id
            by_id[feature["id"]] = kind
    for collection in files.values():
        for feature in collection["features"]:
            check_references(feature["properties"], by_id)


def check_feature(kind: str, feature: dict[str, Any]) -> None:
    geometries, needed, others = STRUCTURE[kind]
    assert UUID_4.fullmatch(feature["id"])
    assert (feature["type"], feature["feature_type"]) == ("Feature", kind)
    properties = {key: value for key, value in feature["properties"].items() if key != names.OWN}
    assert properties.keys() == needed | others
    assert all(properties[key] is not None for key in needed)
    geometry = feature["geometry"]
    assert (None if geometry is None else geometry["type"]) in geometries
    if geometry is not None:
        shape = shapely.from_geojson(json.dumps(geometry))
        assert shape.is_valid
        assert all(
            part.exterior.is_ccw for part in shapely.get_parts(shape) if geometry["type"].endswith("Polygon")
        )
    if kind == "unit":
        assert properties["category"] in names.UNIT_CATEGORIES
    for key in ("name", "short_name"):
        assert properties.get(key) is None or list(properties[key]) == ["en"]


def check_references(properties: dict[str, Any], by_id: dict[str, str]) -> None:
    for key, kind in (("level_id", "level"), ("address_id", "address")):
        assert properties.get(key) is None or by_id[properties[key]] == kind
    for key, kind in (("unit_ids", "unit"), ("building_ids", "building")):
        assert all(by_id[own] == kind for own in properties.get(key) or [])
    for key in ("origin", "destination"):
        if properties.get(key) is not None:
            assert by_id[properties[key]["id"]] == properties[key]["feature_type"]


def test_ids_stay_the_same_and_differ_between_venues(resources: Resources, tmp_path: Path) -> None:
    make_venue(resources)
    make_venue(resources, "other")
    ids = []
    for number, venue in enumerate(("shop", "shop", "other")):
        archive = tmp_path / f"{number}.zip"
        export_imdf(resources, venue, SOMEWHERE, archive, ImdfDetails())
        files = contents(archive)
        del files["manifest.json"]
        ids.append([feature["id"] for collection in files.values() for feature in collection["features"]])
    assert ids[0] == ids[1]
    assert not set(ids[0]) & set(ids[2])


def test_other_programs_see_where_links_lead(resources: Resources, tmp_path: Path) -> None:
    make_venue(resources)
    files = contents(round_trip(resources, "shop", tmp_path, "again"))
    links = {
        entry["properties"][names.OWN]["properties"]["id"]: entry["properties"]
        for entry in files["relationship.geojson"]["features"]
    }
    assert {key: (value["category"], value["direction"]) for key, value in links.items()} == {
        "in": ("traversal.path", "directed"),
        "out": ("traversal.path", "directed"),
        "main": ("traversal.path", "undirected"),
        "up": ("stairs", "directed"),
        "lift": ("elevator", "undirected"),
        "walk": ("traversal.path", "undirected"),
        "down": ("escalator", "undirected"),
    }
    levels = {entry["properties"]["ordinal"]: entry["id"] for entry in files["level.geojson"]["features"]}
    assert links["up"]["destination"] == {"id": levels[1], "feature_type": "level"}


def test_what_can_not_be_exported_is_refused(resources: Resources, tmp_path: Path) -> None:
    with pytest.raises(NotFoundError):
        export_imdf(resources, "nowhere", SOMEWHERE, tmp_path / "x.zip", ImdfDetails())
    with resources.database.write() as connection:
        create_venue(connection, "empty", "Empty")
    with pytest.raises(InvalidInputError, match="no floor"):
        export_imdf(resources, "empty", SOMEWHERE, tmp_path / "x.zip", ImdfDetails())
    assert not list(tmp_path.glob("*.zip"))


@pytest.mark.parametrize("text", ["", "1", "a,b", "1,2,3,4", "200,0", "0,95", "nan,0", "0,0,inf"])
def test_origins_that_are_none(text: str) -> None:
    with pytest.raises(InvalidInputError, match=r"[Oo]rigin"):
        frame_of(text)


def test_the_command_writes_the_archive(resources: Resources, tmp_path: Path) -> None:
    make_venue(resources)
    target = tmp_path / "shop.zip"
    arguments = ["export-plan", "shop", "--origin", "8.55,47.37,30", "--output", str(target)]
    shown = CliRunner().invoke(cli, [*arguments, "--data-dir", str(tmp_path / "data")])
    assert shown.exit_code == 0, shown.output
    assert "3 level, 4 unit, 4 amenity, 7 relationship" in " ".join(shown.output.split())
    assert contents(target)["venue.geojson"]["features"][0]["properties"]["name"] == {"en": "Kaufhaus 百貨"}


def test_without_an_origin_of_its_own_the_archive_lies_where_the_venue_does(
    resources: Resources, tmp_path: Path
) -> None:
    make_venue(resources)
    target = tmp_path / "own.zip"
    with pytest.raises(InvalidInputError, match="no place on Earth: give --origin"):
        export_imdf(resources, "shop", None, target, ImdfDetails())
    assert not target.exists()
    origin = VenueOrigin(latitude=47.37, longitude=8.55, height_m=0.0, heading_deg=30.0)
    with resources.database.write() as connection:
        place_venue(connection, "shop", origin)
    export_imdf(resources, "shop", None, target, ImdfDetails())
    given = tmp_path / "given.zip"
    export_imdf(resources, "shop", frame_of("8.55,47.37,30"), given, ImdfDetails())
    own = contents(target)
    assert {**own, "manifest.json": None} == {**contents(given), "manifest.json": None}
    # Where a plan point lies by the archive is where it lies by the API.
    on_earth = venue_geojson(resources, "shop")["features"]
    door = next(one for one in on_earth if one["id"] == "door")["geometry"]["coordinates"]
    amenities = own["amenity.geojson"]["features"]
    written = next(one for one in amenities if one["properties"]["name"] == {"en": "Door"})
    assert np.abs(np.subtract(written["geometry"]["coordinates"], door)).max() < 1e-9
