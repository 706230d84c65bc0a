"""Walls by areas and links: who walks through one, and where the doors are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.engine.floors.collection import read_collection
from app.engine.floors.plan_distances import distances_by_plan
from app.engine.floors.walls import FloorWalls
from app.geometry.camera import Camera
from tests.plans import GROUND, collection, landmark
from tests.scenes import pose_at

CAMERA = Camera("PINHOLE", 400, 300, (300.0, 300.0, 199.5, 149.5))


def walls_of(features: object) -> FloorWalls | None:
    """Return the walls of a floor whose plan is the frame."""
    return FloorWalls.of(read_collection(features, "ground")[1], lambda points: points)


def crossed(walls: FloorWalls, *steps: tuple[float, float, float, float]) -> list[bool]:
    """Return which steps (x0, y0, x1, y1) lead through a wall."""
    rows: NDArray[np.float64] = np.array(steps)
    return [bool(one) for one in walls.crossed(rows[:, :2], rows[:, 2:])]


def test_nobody_leaves_a_room_but_by_its_door() -> None:
    walls = walls_of(GROUND)
    assert walls is not None
    by_door, by_wall, inside, between = (
        (8, 1.5, 8, 2.5),
        (11, 1.5, 11, 2.5),
        (6.5, 3, 11, 5),
        (3.5, 4, 6.5, 4),
    )
    assert crossed(walls, by_door, by_wall, inside, between) == [False, True, False, True]


def test_a_long_step_does_not_jump_over_a_room() -> None:
    walls = walls_of(GROUND)
    assert walls is not None
    assert crossed(walls, (11, 5.5, 11, 0.5), (1, 1, 19, 1)) == [True, False]


def test_a_floor_without_areas_has_no_walls() -> None:
    assert walls_of(collection(landmark("a", 1, 1))) is None


def test_stairs_lead_to_the_other_floor() -> None:
    walls = walls_of(GROUND)
    assert walls is not None
    (stairs,) = walls.stairs
    share, away_m = stairs.progress(np.array([[17.0, 1.0], [15.0, 1.5]]))
    assert stairs.to_floor == "upper"
    assert np.allclose(share, [0.25, 0.75])
    assert np.allclose(away_m, [0.0, 0.5])


def test_the_plan_says_how_far_floor_ceiling_and_walls_are() -> None:
    walls = walls_of(GROUND)
    pose = pose_at(9.0, 4.0, 1.5, 0.0, 0.0)
    ahead, below = np.array([[199.5, 149.5]]), np.array([[199.5, 290.0]])
    assert abs(distances_by_plan(ahead, CAMERA, pose, 0.0, walls)[0] - 3.0) < 0.25
    down = 1.5 * np.hypot(300.0, 140.5) / 140.5
    room = 3.0 * np.hypot(300.0, 140.5) / 300.0
    found = distances_by_plan(below, CAMERA, pose, 0.0, walls)[0]
    assert abs(found - min(down, room)) < 0.25


def test_through_a_door_the_plan_sees_the_next_room() -> None:
    walls = walls_of(GROUND)
    at_wall, at_door = pose_at(11.0, 4.0, 1.5, -90.0, 0.0), pose_at(8.0, 4.0, 1.5, -90.0, 0.0)
    ahead = np.array([[199.5, 149.5]])
    near = distances_by_plan(ahead, CAMERA, at_wall, 0.0, walls)[0]
    far = distances_by_plan(ahead, CAMERA, at_door, 0.0, walls)[0]
    assert abs(near - 2.0) < 0.25
    assert abs(far - 4.0) < 0.25
