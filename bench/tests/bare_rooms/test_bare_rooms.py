"""White rooms: what is left in them, and where they are seen from."""

from __future__ import annotations

import numpy as np
import pytest

from bench.bare_rooms.command import bare_poses
from bench.render.noise import building
from bench.render.scene import DEMONSTRATION, Building
from bench.render.surfaces import Surface
from bench.venue.bare import PLATE_M, bare_rooms
from bench.venue.layout import ROOMS, Room
from bench.venue.openings import openings_of


@pytest.fixture(scope="module")
def surfaces() -> list[Surface]:
    return bare_rooms()


def test_nothing_is_left_but_what_every_room_has(surfaces: list[Surface]) -> None:
    materials = {"plain_white", "plain_grey", "wood_dark", "wood_light", "metal", "concrete", "linoleum_grey"}
    prints = {"door", "lamp", "socket", "outdoors", "grass"}
    assert {surface.texture.kind for surface in surfaces} <= materials | prints


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.id)
def test_every_room_has_sockets_beside_its_doors_and_windows(surfaces: list[Surface], room: Room) -> None:
    plates = [each for each in surfaces if each.room == room.id and each.texture.kind == "socket"]
    assert plates
    x0, y0, x1, y1 = room.interior
    for plate in plates:
        middle = plate.corner + (plate.right + plate.down) / 2
        assert x0 - 0.05 < middle[0] < x1 + 0.05
        assert y0 - 0.05 < middle[1] < y1 + 0.05
        walls = {"N": abs(middle[1] - y1), "S": abs(middle[1] - y0), "E": abs(middle[0] - x1)}
        walls["W"] = abs(middle[0] - x0)
        side = min(walls, key=lambda each: walls[each])
        along = middle[0] if side in "NS" else middle[1]
        for hole in openings_of(room):
            if hole.side == side:
                assert not hole.start_m - PLATE_M / 2 < along < hole.end_m + PLATE_M / 2


def test_buildings_have_their_sockets_at_other_places(surfaces: list[Surface]) -> None:
    with building(2):
        others = bare_rooms()
    corners = [
        {tuple(each.corner) for each in some if each.texture.kind == "socket"} for some in (surfaces, others)
    ]
    assert len(corners[0] & corners[1]) < 0.5 * len(corners[0])


def test_pictures_of_a_building_say_which_it_is() -> None:
    assert DEMONSTRATION.recipe == {}
    assert Building(2).recipe == {"building": 2}
    assert Building(2, is_bare=True).recipe == {"building": 2, "bare": True}


def test_pictures_are_taken_near_the_walk_and_not_on_it() -> None:
    poses = bare_poses(30, 10, 1)
    walk = np.array([pose.translation for pose in poses[:30]])
    for pose in poses[30:]:
        nearest = np.linalg.norm(walk - pose.translation, axis=1).min()
        assert 0.0 < nearest < 2.0
