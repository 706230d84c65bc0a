"""Images turned by quarters: their cameras and poses see the same points, and gravity tells the turn."""

from __future__ import annotations

import numpy as np
import pytest

from app.errors import InvalidInputError
from app.geometry.se3 import Pose
from app.geometry.turns import angle_to_down_deg, camera_from_turned, turned_camera, upright_turns
from tests.scenes import pose_at
from tests.synthetic import CAMERAS, MODELS, random_pixels


@pytest.mark.parametrize("turns", range(-1, 5))
@pytest.mark.parametrize("model", MODELS)
def test_a_point_lands_on_the_pixel_that_the_turn_moved(model: str, turns: int) -> None:
    camera, rng = CAMERAS[model], np.random.default_rng(0)
    pixels = random_pixels(rng, camera, 100)
    points = camera.unproject(pixels, rng.uniform(1, 5, 100))
    turned = turned_camera(camera, turns)
    seen = turned.project(camera_from_turned(turns).inverse().apply(points))
    rows, columns = np.mgrid[: camera.height, : camera.width]
    map_u, map_v = np.rot90(columns, turns), np.rot90(rows, turns)
    assert map_u.shape == (turned.height, turned.width)
    # Where a turned pixel came from; checked at whole pixels, so within the rounding.
    u, v = np.clip(np.rint(seen).astype(int), 0, [turned.width - 1, turned.height - 1]).T
    came_from = np.stack([map_u[v, u], map_v[v, u]], axis=1)
    assert np.abs(came_from - pixels).max() < 0.51
    assert turned_camera(turned, -turns).params == pytest.approx(camera.params)


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("roll_deg", [-40, -10, 0, 30])
def test_gravity_tells_the_turn(turns: int, roll_deg: float) -> None:
    roll = np.radians(roll_deg)
    upright = np.array([np.sin(roll), np.cos(roll), 0.3])
    # The image as it was held: one that `turns` quarters bring upright.
    held = camera_from_turned(turns).apply(upright[None])[0]
    assert upright_turns(9.81 * held) == turns


def test_looking_straight_down_tells_no_turn() -> None:
    assert upright_turns([0.1, 0.2, 1.0]) is None
    assert upright_turns([0.0, 0.0, -1.0]) is None
    assert upright_turns([0.5, 0.0, 1.0]) == 3
    with pytest.raises(InvalidInputError):
        upright_turns([0.0, 0.0, 0.0])


def test_the_angle_to_down() -> None:
    level = pose_at(1.0, 2.0, yaw_deg=70.0)
    assert angle_to_down_deg(level, [0.0, 2.0, 0.0]) == pytest.approx(0.0, abs=1e-5)
    assert angle_to_down_deg(pose_at(0, 0, pitch_deg=25.0), [0.0, 1.0, 0.0]) == pytest.approx(25.0)
    assert angle_to_down_deg(level @ camera_from_turned(1), [0.0, 1.0, 0.0]) == pytest.approx(90.0)
    assert angle_to_down_deg(Pose.identity(), [0.0, 0.0, 1.0]) == pytest.approx(180.0)
