from itertools import combinations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from bench.render.surfaces import Wall
from bench.venue.layout import BUILDING_M, DOORS, FLOOR_COUNT, ROOMS
from bench.venue.openings import openings_of, shared_wall
from bench.venue.walkable import clearance_m, grid_of


def test_building_is_as_large_as_promised():
    assert BUILDING_M[0] >= 40
    assert BUILDING_M[1] >= 25
    assert FLOOR_COUNT == 2


def test_rooms_of_a_floor_do_not_overlap():
    for a, b in combinations(ROOMS, 2):
        if a.floor == b.floor or "stair" in (a.id, b.id):
            across = min(a.bounds[2], b.bounds[2]) - max(a.bounds[0], b.bounds[0])
            along = min(a.bounds[3], b.bounds[3]) - max(a.bounds[1], b.bounds[1])
            assert across <= 1e-9 or along <= 1e-9, (a.id, b.id)


def test_openings_of_a_wall_do_not_overlap():
    for room in ROOMS:
        for a, b in combinations(openings_of(room), 2):
            if a.side == b.side:
                apart = a.end_m <= b.start_m or b.end_m <= a.start_m
                assert apart or a.top_m <= b.bottom_m or b.top_m <= a.bottom_m, room.id


def test_wall_pieces_cover_the_wall_except_its_openings():
    for room in ROOMS:
        openings = openings_of(room)
        for side in ("N", "E", "S", "W"):
            wall = Wall.of_room(room, side)
            pieces = wall.pieces(openings, None, room.id, room.seed_key)
            area = sum(np.linalg.norm(p.right) * np.linalg.norm(p.down) for p in pieces)
            holes = sum((o.end_m - o.start_m) * (o.top_m - o.bottom_m) for o in openings if o.side == side)
            whole = (wall.end_m - wall.start_m) * (wall.top_m - wall.bottom_m)
            assert area == pytest.approx(whole - holes, abs=1e-6), (room.id, side)


@pytest.mark.parametrize("floor", range(FLOOR_COUNT))
def test_every_open_door_can_be_walked_through(floor):
    for door in DOORS:
        if door.floor == floor and not door.closed:
            side, _, line = shared_wall(door)
            for offset in (-0.5, 0.0, 0.5):
                across, along = line + offset, door.at_m
                point = (along, across) if side in "NS" else (across, along)
                assert clearance_m(np.array([point]), floor)[0] > 0.25, door


@pytest.mark.parametrize("floor", range(FLOOR_COUNT))
def test_every_room_can_be_reached(floor):
    grid = grid_of(floor)
    _, label = connected_components(grid.graph, directed=False)
    rooms = [room for room in ROOMS if room.floor == floor and room.id != "stair"]
    middles = [((r.interior[0] + r.interior[2]) / 2, (r.interior[1] + r.interior[3]) / 2) for r in rooms]
    assert len({label[grid.cell(middle)] for middle in middles}) == 1
