"""Light at times of day: windows shine into their own rooms, and the colour of the light is that of the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.geometry.camera import Camera
from bench.render.daylight import AFTERNOON, EVENING, LAMPS_ALONE, MORNING, window_points
from bench.render.scene import Building, build_scene
from bench.render.sensor import ColourSensor, colour_picture
from bench.render.surfaces import Surface
from bench.venue.layout import WINDOWS, room_by_id

pytest.importorskip("embreex")

ROOM = "0-reception"


@pytest.fixture(scope="module")
def reception(surfaces: list[Surface]) -> list[Surface]:
    mine = [each for each in surfaces if each.room == ROOM]
    return [replace(each, texture=mine[0].texture) for each in mine]


def light_on_floor(surfaces: list[Surface], daylight: object) -> np.ndarray:
    """Return the light on the floor of the room, by places from south, where windows are, to north."""
    scene = build_scene(surfaces, daylight)  # type: ignore[arg-type]
    floor = next(
        k for k, each in enumerate(surfaces) if each.right[2] == each.down[2] == 0 and each.corner[2] < 0.01
        and np.linalg.norm(each.right) > 8
    )  # fmt: skip
    u, v = (int(each) for each in scene.light_origin[floor])
    columns, rows = (round(float(n)) for n in scene.light_scale[floor] * lengths(surfaces[floor]) + 1)
    grid = scene.light[v : v + rows, u : u + columns]
    south_first = grid if surfaces[floor].down[1] > 0 else grid[::-1]
    return south_first.mean(axis=1)


def lengths(surface: Surface) -> np.ndarray:
    return np.array([np.linalg.norm(surface.right), np.linalg.norm(surface.down)])


def test_windows_light_the_floor_near_them_by_day_and_not_in_the_evening(reception: list[Surface]) -> None:
    lamps, noon, evening = (light_on_floor(reception, each) for each in (LAMPS_ALONE, AFTERNOON, EVENING))
    quarter = len(lamps) // 4

    def south_over_north(light: np.ndarray) -> float:
        return float(light[:quarter].mean() / light[-quarter:].mean())

    assert south_over_north(noon) > 1.05 * south_over_north(lamps)
    assert south_over_north(evening) == pytest.approx(south_over_north(lamps), rel=0.03)
    assert evening.mean() < 0.6 * lamps.mean()


def test_points_of_a_window_are_inside_its_room() -> None:
    for window in WINDOWS:
        room = room_by_id(window.room)
        places, inward = window_points(room, window)
        x0, y0, x1, y1 = room.interior
        assert ((places[:, :2] > [x0, y0]) & (places[:, :2] < [x1, y1])).all()
        middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
        assert (middle - places[0, :2]) @ inward[:2] > 0


def test_times_of_day_are_buildings_of_their_own() -> None:
    assert Building().recipe == {}
    assert len({Building(daylight=each) for each in (LAMPS_ALONE, MORNING, AFTERNOON, EVENING)}) == 4
    assert Building(daylight=EVENING).recipe == {"light": "19:00"}


def test_warm_light_makes_pictures_red() -> None:
    camera = Camera("PINHOLE", 64, 48, (60.0, 60.0, 31.5, 23.5))
    grey = np.full((48, 64, 3), 120, np.uint8)
    sensor = ColourSensor(gains=EVENING.gains)
    picture = colour_picture(np.random.default_rng(1), grey, camera, sensor).mean(axis=(0, 1))
    assert picture[0] > picture[1] > picture[2]
