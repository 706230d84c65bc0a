"""An indoor map becomes a venue: a tiny one made here, and a real building where its data is there."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli import app as cli
from app.engine.navigation.search import Limits
from app.engine.navigation.survey import survey
from app.errors import InvalidInputError, NoRouteError, OffNetworkError
from app.importers.plans.registry import read_indoor_map
from app.services.floor_features import FeatureLibrary, stored_features
from app.services.plans.import_plan import import_indoor_map
from app.services.resources import Resources
from app.services.routes import RouteService
from app.settings import Settings
from app.storage.floors import list_floors, put_floor
from app.storage.venues import create_venue, list_venues
from tests.importers.plans.campus_imdf import campus
from tests.importers.plans.imdf_maps import features, write_imdf
from tests.importers.plans.wrld_maps import files, path, room, write
from tests.services.plans.venues import (
    assert_same_features,
    assert_same_routes,
    features_of,
    floors_of,
    round_trip,
)

REAL_BUILDING = Path(__file__).parents[4] / "shared" / "data" / "westport_house"


@pytest.fixture
def resources(tmp_path: Path) -> Iterator[Resources]:
    opened = Resources.open(Settings(_env_file=None, data_dir=tmp_path / "data", open=True))
    yield opened
    opened.close()


def routes_of(resources: Resources) -> RouteService:
    return RouteService(resources.database, FeatureLibrary(resources.database))


def test_a_tiny_map_gets_floors_and_routes(resources: Resources, tmp_path: Path) -> None:
    import_indoor_map(resources, "house", read_indoor_map(write(tmp_path / "map", files())), storey_m=3.0)
    with resources.database.read() as connection:
        floors = list_floors(connection, "house")
    assert [(f.id, f.name, f.z_min_m, f.z_max_m) for f in floors] == [
        ("0", "Level 0", 0, 3),
        ("1", "Level 1", 3, 6),
    ]
    routes = routes_of(resources)
    # 4 m to the door, 10 m along, 4 m to the stairs, 10 m up, and all of it again.
    by_stairs = routes.route("house", "office", "lab", Limits(frozenset({"lift"})))
    assert by_stairs.distance_m == pytest.approx(18 + 10 + 18, abs=0.02)
    by_lift = routes.route("house", "office", "lab")
    assert by_lift.distance_m == pytest.approx(10 + 15 + 10, abs=0.02)
    found = survey(routes.network("house"))
    assert (found.pairs, found.routed_pairs, found.unmet) == (10, 6, 0)
    assert found.landmark_pairs == (10, 10)


def test_a_floor_that_is_there_keeps_its_heights(resources: Resources, tmp_path: Path) -> None:
    with resources.database.write() as connection:
        create_venue(connection, "house", "My house")
        more = {"plan_from_world": None, "plan_residual_m": None}
        put_floor(connection, "house", "1", name="Mine", level=1, z_min_m=7.0, z_max_m=9.0, **more)
    import_indoor_map(resources, "house", read_indoor_map(write(tmp_path / "map", files())))
    with resources.database.read() as connection:
        assert list_venues(connection)[0].name == "My house"
        assert [(f.id, f.name, f.z_min_m) for f in list_floors(connection, "house")] == [
            ("0", "Level 0", 0.0),
            ("1", "Mine", 7.0),
        ]
    assert len(stored_features(resources, "house", "1")["features"]) > 5


def test_a_map_that_is_wrong_leaves_nothing(resources: Resources, tmp_path: Path) -> None:
    values = files()
    values["l1.geojson"]["features"].append(room(4, "Twice", "room", 0, 30))
    values["p1.geojson"]["features"].append(path(11, "pathway", (50, 0), (60, 0)))
    with pytest.raises(InvalidInputError, match="another area with the id '4'"):
        import_indoor_map(resources, "house", read_indoor_map(write(tmp_path / "map", values)))
    with resources.database.read() as connection:
        assert list_venues(connection) == []


def test_the_command_prints_what_is_joined(tmp_path: Path) -> None:
    folder = write(tmp_path / "map", files())
    arguments = ["import-plan", str(folder), "--venue", "house", "--data-dir", str(tmp_path / "data")]
    shown = CliRunner().invoke(cli, arguments)
    assert shown.exit_code == 0, shown.output
    assert "Pairs of landmarks with a route: 10 of 10 (100.0 %)" in shown.output
    again = CliRunner().invoke(cli, [*arguments, "--json"])
    assert json.loads(again.output)["routed_pairs"] == 6


@pytest.mark.skipif(not REAL_BUILDING.is_dir(), reason="the real building's plan is not here")
def test_a_real_building_has_routes_where_it_has_paths(resources: Resources) -> None:
    import_indoor_map(resources, "westport", read_indoor_map(REAL_BUILDING))
    routes = routes_of(resources)
    found = survey(routes.network("westport"))
    assert len(found.floors) == 7
    assert found.unmet == 0
    assert len(found.parts) == 1
    assert found.landmark_pairs[0] == found.landmark_pairs[1] == 300
    no_lift = Limits(frozenset({"lift"}))
    by_stairs = routes.route("westport", "meeting-room-large", "G:bash-st-entrance", no_lift)
    assert "stairs" in by_stairs.modes
    by_lift = routes.route(
        "westport", "meeting-room-large", "G:bash-st-entrance", Limits(accessible_only=True)
    )
    assert {*by_lift.modes} == {"walk", "lift"}
    assert 50 < by_lift.distance_m < 150
    with pytest.raises(NoRouteError, match="Floor '4' has no link"):
        routes.route("westport", "kitchen", "4:0,0")


def test_an_imdf_archive_of_another_program_leaves_as_it_came(resources: Resources, tmp_path: Path) -> None:
    import_indoor_map(resources, "house", read_indoor_map(write_imdf(tmp_path / "house.zip", features())))
    round_trip(resources, "house", tmp_path, "again")
    # Areas and landmarks of two levels, and the links that were made from the shapes of their rooms and doors.
    assert assert_same_features(resources, "house", "again") > 20
    assert assert_same_routes(resources, "house", "again") > 20


@pytest.mark.skipif(not REAL_BUILDING.is_dir(), reason="the real building's plan is not here")
def test_a_real_building_comes_back_the_same_from_imdf(resources: Resources, tmp_path: Path) -> None:
    import_indoor_map(resources, "westport", read_indoor_map(REAL_BUILDING))
    round_trip(resources, "westport", tmp_path, "again")
    assert assert_same_features(resources, "westport", "again") == 132
    assert assert_same_routes(resources, "westport", "again") == 300


def test_a_campus_as_a_university_writes_it_comes_back_the_same(resources: Resources, tmp_path: Path) -> None:
    folder = write_imdf(tmp_path / "campus", campus())
    (folder / "manifest.json").unlink()
    read = read_indoor_map(folder)
    assert read.left_out == {"attraction": 1, "detail": 1, "enviroment.amenity": 1, "enviroment.area": 1}
    assert read.name == "Политехнический университет"
    import_indoor_map(resources, "campus", read)
    assert [(one[0], one[1], one[2]) for one in floors_of(resources, "campus")] == [
        ("1", "Этаж 1", 0),
        ("3", "Этаж 3", 2),
    ]
    landmarks = [own for kind, own in features_of(resources, "campus", "1") if kind == "landmark"]
    assert landmarks == [
        "stairs", "restroom-female", "classroom-101", "classroom-102", "auditorium-105", "lobby",
    ]  # fmt: skip
    route = routes_of(resources).route("campus", "classroom-101", "auditorium-305")
    assert "stairs" in route.modes
    assert route.distance_m > 40
    # The tower has one room and nothing that joins it.
    with pytest.raises(OffNetworkError):
        routes_of(resources).route("campus", "classroom-101", "lobby")
    round_trip(resources, "campus", tmp_path, "again")
    assert assert_same_features(resources, "campus", "again") == 39
    assert assert_same_routes(resources, "campus", "again") == 45
