"""The demonstration building as an IMDF archive and back: the same areas, landmarks, links and routes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.services.floor_features import store_features
from app.services.resources import Resources
from app.settings import Settings
from app.storage.floors import put_floor
from app.storage.venues import create_venue
from bench.venue.layout import FLOOR_COUNT
from bench.venue.plan_features import features
from tests.services.plans.venues import assert_same_features, assert_same_routes, round_trip

# As `roomfix demo` places the plans: a quarter turn, and moved differently on each floor.
PLANS = [(30.5, 3.25, 0.0), (28.25, 1.5, -3.5)]


def plan_from_world(floor: int) -> np.ndarray:
    matrix = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    matrix[:3, 3] = PLANS[floor]
    return matrix


def demonstration(resources: Resources) -> None:
    with resources.database.write() as connection:
        create_venue(connection, "demo", "Demonstration")
        for floor in range(FLOOR_COUNT):
            put_floor(
                connection,
                "demo",
                str(floor),
                name=f"Floor {floor}",
                level=floor,
                z_min_m=3.5 * floor - 0.5,
                z_max_m=3.5 * floor + 3.5,
                plan_from_world=plan_from_world(floor),
                plan_residual_m=None,
            )
    for floor in range(FLOOR_COUNT):
        store_features(resources, "demo", str(floor), features(floor))


def test_the_demonstration_building_comes_back_the_same(tmp_path: Path) -> None:
    resources = Resources.open(Settings(_env_file=None, data_dir=tmp_path / "data", open=True))
    demonstration(resources)
    round_trip(resources, "demo", tmp_path, "again")
    # 39 areas, 19 POIs, 80 landmarks and 86 links.
    assert assert_same_features(resources, "demo", "again") == 224
    # One of seven pairs, in which each landmark is: all the features that make the routes are compared above.
    assert assert_same_routes(resources, "demo", "again", every=7) == 452
    resources.close()
