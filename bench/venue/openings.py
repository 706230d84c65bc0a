"""The holes in the walls of the demonstration building: where doors and windows are in a room's walls."""

from __future__ import annotations

from dataclasses import dataclass

from bench.venue.layout import DOORS, FLOOR_HEIGHT_M, WINDOWS, Door, Room, Side, room_by_id


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in one wall of a room: `start_m..end_m` along the wall (world x or y), `bottom_m..top_m` in
    world z."""

    side: Side
    start_m: float
    end_m: float
    bottom_m: float
    top_m: float


def shared_wall(door: Door) -> tuple[Side, Side, float]:
    """Return the side of the wall in rooms `a` and `b` of a door, and the world x or y of its centre line."""
    a, b = room_by_id(door.a).bounds, room_by_id(door.b).bounds
    candidates: tuple[tuple[float, float, Side, Side], ...] = (
        (a[2], b[0], "E", "W"),
        (a[0], b[2], "W", "E"),
        (a[3], b[1], "N", "S"),
        (a[1], b[3], "S", "N"),
    )
    for line_a, line_b, side_a, side_b in candidates:
        if abs(line_a - line_b) < 1e-6 and _spans(a, side_a, door) and _spans(b, side_b, door):
            return side_a, side_b, line_a
    raise ValueError(f"{door.a} and {door.b} share no wall at {door.at_m}")


def _spans(bounds: tuple[float, float, float, float], side: Side, door: Door) -> bool:
    low, high = (bounds[0], bounds[2]) if side in "NS" else (bounds[1], bounds[3])
    return low < door.at_m - door.width_m / 2 and door.at_m + door.width_m / 2 < high


def openings_of(room: Room) -> list[Opening]:
    """Return the holes in a room's walls: doors (closed ones too, their leaf stands in the hole) and
    windows."""
    found = []
    for door in DOORS:
        if room.id in (door.a, door.b):
            side_a, side_b, _ = shared_wall(door)
            base = door.floor * FLOOR_HEIGHT_M
            half = door.width_m / 2
            side = side_a if room.id == door.a else side_b
            found.append(Opening(side, door.at_m - half, door.at_m + half, base, base + door.height_m))
    for window in WINDOWS:
        if window.room == room.id:
            half, base = window.width_m / 2, room.base_m + window.sill_m
            found.append(
                Opening(window.side, window.at_m - half, window.at_m + half, base, base + window.height_m)
            )
    return found
