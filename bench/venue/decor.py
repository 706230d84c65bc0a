"""What hangs on the walls: paintings with labels, posters, boards and name plates, along each free
stretch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.render.atlas import Texture
from bench.render.noise import seeded
from bench.render.surfaces import Box, Surface, Wall
from bench.venue.building import SIDES, stair_boxes
from bench.venue.furnishing import FURNITURE
from bench.venue.furniture import build
from bench.venue.layout import CORRIDORS, DOORS, ROOMS, Room, room_by_id
from bench.venue.openings import Opening, openings_of, shared_wall

# kinds of art with their shares, and the gaps (metres) between pieces
STYLES: dict[str, tuple[dict[str, float], tuple[float, float]]] = {
    "gallery": ({"painting": 0.9, "poster": 0.1}, (0.35, 0.8)),
    "mixed": ({"painting": 0.4, "poster": 0.45, "noticeboard": 0.15}, (0.4, 1.0)),
    "poster": ({"poster": 0.55, "painting": 0.25, "noticeboard": 0.2}, (0.5, 1.3)),
    "workshop": ({"poster": 0.4, "noticeboard": 0.35, "whiteboard": 0.25}, (0.8, 2.0)),
    "sparse": ({"whiteboard": 0.3, "poster": 0.7}, (2.2, 4.0)),
    "corridor": ({"poster": 0.6, "noticeboard": 0.25, "painting": 0.15}, (1.0, 2.2)),
}
SIZES_M: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "painting": ((0.7, 1.7), (0.7, 1.2)),
    "poster": ((0.6, 0.85), (0.85, 1.15)),
    "noticeboard": ((1.0, 1.5), (0.8, 1.0)),
    "whiteboard": ((1.5, 2.0), (1.0, 1.1)),
}
PRINTS = ("painting", "poster", "noticeboard")
MIDDLE_HEIGHT_M = 1.55
# The one piece that differs from corridor to corridor, by its number along the wall.
ODD_POSTER = 4


def furniture_of(room: Room) -> list[Box]:
    """Return the boxes of a room's furniture, and of the steps in the stair."""
    if room.id == "stair":
        return stair_boxes()
    x0, y0, _, _ = room.interior
    return [box for item in FURNITURE.get(room.id, ()) for box in build(item, (x0, y0), room.base_m)]


def decoration() -> list[Surface]:
    """Return the surfaces of all furniture and wall decoration."""
    hung = [
        surface
        for room in ROOMS
        for k, box in enumerate(_hung(room))
        for surface in box.surfaces(room.id, f"{room.seed_key}/h{k}")
    ]
    return furniture() + hung


def furniture() -> list[Surface]:
    """Return the surfaces of all furniture."""
    return [
        surface
        for room in ROOMS
        if room.id != "stair"
        for k, box in enumerate(furniture_of(room))
        for surface in box.surfaces(room.id, f"{room.seed_key}/f{k}")
    ]


def wall_prints(room: Room) -> dict[str, Box]:
    """Return the pictures, posters and notice boards on a room's walls by name; each shows its `front`."""
    hung = (box for box in _hung(room) if box.front is not None and box.front.kind in PRINTS)
    return {f"{room.id}/{number}": box for number, box in enumerate(hung)}


def _hung(room: Room) -> Iterator[Box]:
    yield from _name_plates(room)
    if room.art not in STYLES:
        return
    number = 0
    for side in SIDES:
        wall = Wall.of_room(room, side)
        openings = openings_of(room)
        for start, end in _free_stretches(room, wall, openings):
            rng = seeded(room.seed_key, side, round((start - wall.start_m) * 100))
            for kind, at, size in _spread(rng, start, end, room.art):
                picture = Texture(kind, int(rng.integers(0, 2**30)))
                if room.id in CORRIDORS and number == ODD_POSTER:
                    picture = Texture("poster", 1000 + CORRIDORS.index(room.id))
                number += 1
                yield from _piece(wall, picture, at, size, room.art == "gallery")


def _free_stretches(room: Room, wall: Wall, openings: list[Opening]) -> list[tuple[float, float]]:
    """Return the parts of a wall with no opening in them and no tall furniture before them."""
    taken = [(o.start_m - 0.45, o.end_m + 0.45) for o in openings if o.side == wall.side]
    axis = 0 if wall.side in "NS" else 1
    for box in furniture_of(room):
        corners = box.corners_xy()
        near = np.abs(corners[:, 1 - axis] - wall.line_m).min() < 0.5
        if near and box.base_m + box.size_m[2] - room.base_m > 1.0:
            taken.append((corners[:, axis].min() - 0.05, corners[:, axis].max() + 0.05))
    free, at = [], wall.start_m + 0.25
    for start, end in [*sorted(taken), (wall.end_m - 0.25, wall.end_m)]:
        if start - at > 0.6:
            free.append((at, start))
        at = max(at, end)
    return free


def _spread(
    rng: np.random.Generator, start: float, end: float, art: str
) -> Iterator[tuple[str, float, tuple[float, float]]]:
    """Yield kind, middle and size (width, height) of the pieces along a free stretch."""
    shares, gaps = STYLES[art]
    at = start + float(rng.uniform(0, gaps[0]))
    while True:
        kind = str(rng.choice(list(shares), p=list(shares.values())))
        (w0, w1), (h0, h1) = SIZES_M[kind]
        width, height = round(float(rng.uniform(w0, w1)), 2), round(float(rng.uniform(h0, h1)), 2)
        if at + width > end:
            return
        yield kind, at + width / 2, (width, height)
        at += width + float(rng.uniform(*gaps))


def _piece(
    wall: Wall, picture: Texture, at: float, size: tuple[float, float], labelled: bool
) -> Iterator[Box]:
    width, height = size
    base = wall.bottom_m + MIDDLE_HEIGHT_M - height / 2 + (picture.seed % 100 - 50) * 0.002
    yield _plaque(wall, picture, at, base, (width, height), 0.03)
    if labelled:
        beside = at + (width / 2 + 0.16) * (1 if wall.forward else -1)
        if wall.start_m + 0.2 < beside < wall.end_m - 0.2:
            yield _plaque(
                wall, Texture("plate", picture.seed), beside, wall.bottom_m + 1.15, (0.2, 0.14), 0.01
            )


def _plaque(
    wall: Wall, texture: Texture, at: float, base: float, size: tuple[float, float], depth: float
) -> Box:
    x, y, _ = wall.point(at, base, depth / 2 + 0.001)
    return Box(
        centre=(float(x), float(y)),
        base_m=base,
        size_m=(size[0], depth, size[1]),
        yaw_deg=wall.yaw_deg,
        material="wood_dark",
        front=texture,
        is_obstacle=False,
    )


def _name_plates(room: Room) -> Iterator[Box]:
    """Yield a sign over each door of a room, naming the room behind it; in corridors a small number beside
    it."""
    for door in DOORS:
        if room.id not in (door.a, door.b):
            continue
        other = room_by_id(door.b if room.id == door.a else door.a)
        side_a, side_b, _ = shared_wall(door)
        wall = Wall.of_room(room, side_a if room.id == door.a else side_b)
        bottom = door.floor * 3.5
        if room.id in CORRIDORS:
            at = door.at_m + door.width_m / 2 + 0.28
            text = f"{door.floor}.{DOORS.index(door) % 90 + 10}"
            yield _plaque(wall, Texture("plate", 0, text=text), at, bottom + 1.5, (0.16, 0.1), 0.01)
        else:
            base = bottom + door.height_m + 0.12
            yield _plaque(
                wall,
                Texture("sign", other.floor, text=other.name.upper()),
                door.at_m,
                base,
                (0.95, 0.24),
                0.02,
            )
