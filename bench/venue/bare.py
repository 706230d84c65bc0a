"""The building without furniture and pictures, all white: doors, windows, lamps, sockets and switches are what is left.

So are rooms before somebody moves in, clean rooms and many corridors. Little in them can be recognised.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.render.surfaces import Box, Surface, Wall
from bench.venue.building import SIDES, shell
from bench.venue.layout import ROOMS, Room
from bench.venue.openings import Opening, openings_of

WHITE = Texture("plain_white")
GROUND = Texture("plain_grey")
PLATE_M = 0.08
PLATE_DEPTH_M = 0.012
SOCKET_HEIGHT_M = 0.3
SWITCH_HEIGHT_M = 1.05
# From the frame of a door to its switch.
SWITCH_GAP_M = 0.2
# Between two places with sockets along a wall.
SOCKET_GAPS_M = (1.6, 3.2)


def bare_rooms() -> list[Surface]:
    """Return every surface of the bare building."""
    walls = {texture for room in ROOMS for texture in _materials(room)}
    found = [_painted(surface, walls) for surface in shell()]
    return found + [
        face
        for room in ROOMS
        for number, box in enumerate(_plates(room))
        for face in box.surfaces(room.id, f"{room.id}/plate{number}")
    ]


def _materials(room: Room) -> set[str]:
    accent = {room.accent[1]} if room.accent else set()
    return {room.wall, room.ceiling, room.ground} | accent


def _painted(surface: Surface, materials: set[str]) -> Surface:
    if surface.is_bright or surface.texture.kind not in materials:
        return surface
    return replace(surface, texture=GROUND if surface.look.endswith("/g") else WHITE)


def _plates(room: Room) -> Iterator[Box]:
    """Yield the sockets of a room, one to three side by side, and the switch beside each of its doors."""
    openings = openings_of(room)
    for side in SIDES:
        wall = Wall.of_room(room, side)
        holes = [opening for opening in openings if opening.side == side]
        rng = seeded(room.id, side, "sockets")
        at = wall.start_m + float(rng.uniform(0.3, 1.5))
        while at < wall.end_m - 0.4:
            count = int(rng.integers(1, 4))
            places = [at + PLATE_M * number for number in range(count)]
            if not any(_is_taken(place, holes) for place in places):
                yield from (_plate(wall, place, SOCKET_HEIGHT_M, "") for place in places)
            at += float(rng.uniform(*SOCKET_GAPS_M))
        for door in (hole for hole in holes if hole.bottom_m == room.base_m):
            beside = door.start_m - SWITCH_GAP_M
            if beside > wall.start_m + PLATE_M and not _is_taken(beside, holes):
                yield _plate(wall, beside, SWITCH_HEIGHT_M, "switch")


def _is_taken(along_m: float, holes: list[Opening]) -> bool:
    return any(hole.start_m - 0.12 < along_m < hole.end_m + 0.12 for hole in holes)


def _plate(wall: Wall, along_m: float, height_m: float, text: str) -> Box:
    base = wall.bottom_m + height_m
    x, y, _ = wall.point(along_m, base, PLATE_DEPTH_M / 2)
    return Box(
        centre=(float(x), float(y)),
        base_m=base,
        size_m=(PLATE_M, PLATE_DEPTH_M, PLATE_M),
        yaw_deg=wall.yaw_deg,
        material="plain_white",
        front=Texture("socket", text=text),
        is_obstacle=False,
    )
