"""How light the building is at a time of day: lamps, what comes through the windows, and the colour of the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.render.surfaces import Surface
from bench.venue.layout import ROOMS, WINDOWS, Room, Side, Window

Floats = NDArray[np.float32]

# How far inside the room the points of a window are that shine into it: its pane stays behind them.
INSIDE_M = 0.12
# They are at these shares of the window's width and height.
SHARES = (0.25, 0.75)
# Keeps the light next to a window finite.
NEAREST_M2 = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Daylight:
    """Light at a time of day. `lamps` and `ambient` are factors of the lamps' light and of the light that comes from
    everywhere; `sky` is how bright the windows shine, those on a side of `sunny` by that factor more; `outdoors` is
    how bright one sees what is behind them. `gains` are what a camera of fixed white balance makes of red, green and
    blue."""

    name: str = ""
    lamps: float = 1.0
    ambient: float = 1.0
    sky: float = 0.0
    sunny: tuple[tuple[Side, float], ...] = ()
    outdoors: float = 1.0
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def recipe(self) -> dict[str, Any]:
        """What is written beside pictures in this light; nothing for the lamps alone."""
        return {"light": self.name} if self.name else {}


LAMPS_ALONE = Daylight()
MORNING = Daylight(
    name="9:00",
    lamps=0.6,
    ambient=0.85,
    sky=3.0,
    sunny=(("E", 2.0), ("S", 1.3)),
    gains=(1.04, 1.0, 0.93),
)
AFTERNOON = Daylight(
    name="14:00",
    lamps=0.6,
    ambient=0.9,
    sky=3.5,
    sunny=(("S", 1.8), ("W", 1.5)),
    gains=(0.97, 1.0, 1.05),
)
# Dark outside, half of the lamps, and warm ones.
EVENING = Daylight(name="19:00", lamps=0.5, ambient=0.5, outdoors=0.05, gains=(1.12, 0.97, 0.72))


def window_light(
    points: Floats,
    normals: Floats,
    surfaces: list[Surface],
    owner: NDArray[np.int64],
    embree: Any,
    of: Daylight,
) -> Floats:
    """Return the light (m,) on points (m, 3) from the windows of their own room, with shadows.

    `owner` (m,) is the surface that each point is on. A window shines as a diffuse area does.
    """
    light = np.zeros(len(points), np.float32)
    if of.sky <= 0:
        return light
    room_of = np.array([s.room for s in surfaces])[owner]
    for room in ROOMS:
        mine = np.flatnonzero(room_of == room.id)
        windows = [window for window in WINDOWS if window.room == room.id]
        for window in windows if len(mine) else ():
            strength = of.sky * dict(of.sunny).get(window.side, 1.0) * window.width_m * window.height_m
            places, inward = window_points(room, window)
            for place in places:
                seen = _from_area(points[mine], normals[mine], place, inward, embree)
                light[mine] += strength / len(places) * seen
    return light


def window_points(room: Room, window: Window) -> tuple[Floats, Floats]:
    """Return points (4, 3) of a window just inside its room, and the direction (3,) into the room."""
    x0, y0, x1, y1 = room.interior
    wall = {"W": x0 + INSIDE_M, "E": x1 - INSIDE_M, "S": y0 + INSIDE_M, "N": y1 - INSIDE_M}[window.side]
    inward = {"W": (1, 0, 0), "E": (-1, 0, 0), "S": (0, 1, 0), "N": (0, -1, 0)}[window.side]
    found = []
    for across in SHARES:
        for up in SHARES:
            along = window.at_m + (across - 0.5) * window.width_m
            z = room.base_m + window.sill_m + up * window.height_m
            found.append((wall, along, z) if window.side in "WE" else (along, wall, z))
    return np.array(found, np.float32), np.array(inward, np.float32)


def _from_area(points: Floats, normals: Floats, place: Floats, inward: Floats, embree: Any) -> Floats:
    """Return cos cos / (pi d^2) of a small area that faces `inward`, 0 for points in its shadow."""
    offsets = place - points
    squared = np.einsum("ij,ij->i", offsets, offsets)
    far = np.sqrt(squared)
    unit = offsets / np.maximum(far, 1e-3)[:, None]
    facing = np.clip(np.einsum("ij,ij->i", unit, normals), 0, 1) * np.clip(-unit @ inward, 0, 1)
    lit = facing > 0
    origins = np.ascontiguousarray(points[lit], np.float32)
    hit_m = embree.run(origins, np.ascontiguousarray(unit[lit], np.float32), query="DISTANCE")
    lit[lit] = np.asarray(hit_m >= far[lit] - 0.02)
    return np.asarray(lit * facing / (np.pi * (NEAREST_M2 + squared)), dtype=np.float32)
