"""The demonstration venue's features are valid, and its rooms are joined over both floors."""

from __future__ import annotations

import itertools

import pytest

from app.engine.floors.collection import parse_features
from app.engine.floors.floor import Floor
from app.engine.floors.places import PlaceIndex
from app.engine.navigation.network import Network, build_network
from app.engine.navigation.survey import survey
from bench.demo import floor_plans
from tests.engine.navigation.test_navigation import route


@pytest.fixture(scope="module")
def network() -> Network:
    plans = floor_plans()
    floors = []
    for plan in plans:
        features = parse_features(plan.features, plan.id, [one.id for one in plans])[1]
        floor = Floor(
            venue_id="demo",
            id=plan.id,
            name=plan.name,
            level=plan.level,
            z_min_m=plan.z_min_m,
            z_max_m=plan.z_max_m,
            plan_from_world=plan.plan_from_world,
            plan_residual_m=None,
            plan=None,
            features_sha256="x",
        )
        floors.append((floor, PlaceIndex(features)))
    return build_network(floors)


def test_all_landmarks_are_joined(network: Network) -> None:
    found = survey(network)
    assert (len(found.parts), found.unmet) == (1, 0)
    assert found.routed_pairs == found.pairs


def test_a_route_between_floors_is_as_long_back_as_there(network: Network) -> None:
    up, down = route(network, "0-reception", "1-library"), route(network, "1-library", "0-reception")
    assert up.distance_m == pytest.approx(down.distance_m)
    assert {*up.modes} == {"walk", "stairs"}
    lengths = [b.along_m - a.along_m for a, b in itertools.pairwise(up.points)]
    assert min(lengths) >= 0
    assert "stairs" not in route(network, "0-reception", "1-library", accessible=True).modes
