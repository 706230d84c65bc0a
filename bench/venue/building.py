"""The shell of the building as surfaces: floors, walls with openings, ceilings, lamps, stairs, outdoors."""

from __future__ import annotations

import numpy as np

from bench.render.atlas import Texture
from bench.render.surfaces import Box, Surface, Wall, rectangle
from bench.venue.layout import (
    BUILDING_M,
    DOORS,
    FLOOR_HEIGHT_M,
    ROOMS,
    STAIR_RISERS,
    STAIR_START_Y_M,
    STAIR_TREAD_M,
    WALL_THICKNESS_M,
    WINDOWS,
    Door,
    Room,
    Side,
    Window,
    room_by_id,
)
from bench.venue.openings import Opening, openings_of, shared_wall

SIDES: tuple[Side, ...] = ("N", "E", "S", "W")
LAMP_SIZE_M = 0.6
TRIM_M = 0.07


def shell() -> list[Surface]:
    """Return every surface of the building that is not furniture or decoration."""
    found = [surface for room in ROOMS for surface in _room(room)]
    found += [surface for door in DOORS for surface in _door(door)]
    found += [surface for window in WINDOWS for surface in _window(window)]
    return found + _stairs() + _outdoors()


def _room(room: Room) -> list[Surface]:
    openings, look = openings_of(room), room.seed_key
    found = []
    for side in SIDES:
        material = room.accent[1] if room.accent and room.accent[0] == side else room.wall
        found += Wall.of_room(room, side).pieces(openings, Texture(material), room.id, look)
    x0, y0, x1, y1 = room.interior
    top = room.base_m + room.height_m
    if room.id != "stair":
        ground = Texture(room.ground)
        found.append(
            rectangle((x0, y1, room.base_m), (x1 - x0, 0, 0), (0, y0 - y1, 0), ground, room.id, look + "/g")
        )
    else:
        ground = Texture(room.ground)
        found.append(rectangle((x0, y1, 0), (x1 - x0, 0, 0), (0, y0 - y1, 0), ground, room.id, look + "/g"))
    ceiling = Texture(room.ceiling)
    found.append(rectangle((x0, y0, top), (x1 - x0, 0, 0), (0, y1 - y0, 0), ceiling, room.id, look + "/c"))
    return found + [_lamp(room, place) for place in lamp_places(room)]


def lamp_places(room: Room) -> list[tuple[float, float, float]]:
    """Return the world points of a room's lamps, just under the ceiling, about one every three metres."""
    x0, y0, x1, y1 = room.interior
    nx, ny = max(1, round((x1 - x0) / 3.0)), max(1, round((y1 - y0) / 3.0))
    z = room.base_m + room.height_m - 0.02
    return [
        (x0 + (x1 - x0) * (i + 0.5) / nx, y0 + (y1 - y0) * (j + 0.5) / ny, z)
        for i in range(nx)
        for j in range(ny)
    ]


def _lamp(room: Room, place: tuple[float, float, float]) -> Surface:
    x, y, z = place
    half = LAMP_SIZE_M / 2
    texture = Texture("lamp", size_m=(LAMP_SIZE_M, LAMP_SIZE_M))
    return Surface(
        corner=np.array([x - half, y - half, z]),
        right=np.array([2 * half, 0, 0]),
        down=np.array([0, 2 * half, 0]),
        texture=texture,
        room=room.id,
        is_bright=True,
    )


def _reveal(opening: Opening, line_a: float, line_b: float, room: str, material: str) -> list[Surface]:
    """Return the four faces inside a hole in a wall between the lines `line_a` < `line_b`."""
    a, b, z0, z1 = opening.start_m, opening.end_m, opening.bottom_m, opening.top_m
    depth, texture = line_b - line_a, Texture(material)

    def face(
        corner: tuple[float, float, float],
        right: tuple[float, float, float],
        down: tuple[float, float, float],
    ) -> Surface:
        if opening.side in "EW":
            corner, right, down = ((v[1], v[0], v[2]) for v in (corner, right, down))
        return rectangle(corner, right, down, texture, room, f"reveal/{opening.side}")

    return [
        face((a, line_a, z1), (0, depth, 0), (0, 0, z0 - z1)),
        face((b, line_a, z1), (0, depth, 0), (0, 0, z0 - z1)),
        face((a, line_a, z1), (b - a, 0, 0), (0, depth, 0)),
        face((a, line_a, z0), (b - a, 0, 0), (0, depth, 0)),
    ]


def _trim(wall: Wall, opening: Opening, material: str, with_sill: bool) -> list[Box]:
    """Return the frame of boards around an opening, on one face of its wall."""
    a, b, z0, z1 = opening.start_m, opening.end_m, opening.bottom_m, opening.top_m
    boards = [(a - TRIM_M, a, z0, z1 + TRIM_M), (b, b + TRIM_M, z0, z1 + TRIM_M), (a, b, z1, z1 + TRIM_M)]
    if with_sill:
        boards.append((a - TRIM_M, b + TRIM_M, z0 - TRIM_M, z0))
    found = []
    for low, high, bottom, top in boards:
        x, y, _ = wall.point((low + high) / 2, bottom, 0.012)
        size = (high - low, 0.024, top - bottom)
        found.append(
            Box(
                centre=(float(x), float(y)),
                base_m=bottom,
                size_m=size,
                yaw_deg=wall.yaw_deg,
                material=material,
                is_obstacle=False,
            )
        )
    return found


def _door(door: Door) -> list[Surface]:
    half_wall = WALL_THICKNESS_M / 2
    side_a, side_b, line = shared_wall(door)
    base = door.floor * FLOOR_HEIGHT_M
    a, b = door.at_m - door.width_m / 2, door.at_m + door.width_m / 2
    opening = Opening(side_a, a, b, base, base + door.height_m)
    material = "metal" if door.b.endswith("lift") else "wood_dark"
    found = _reveal(opening, line - half_wall, line + half_wall, door.a, material)
    for room_id, side in ((door.a, side_a), (door.b, side_b)):
        room = room_by_id(room_id)
        for board in _trim(Wall.of_room(room, side), opening, material, with_sill=False):
            found += board.surfaces(room_id, "trim")
    if door.closed:
        centre = (door.at_m, line) if side_a in "NS" else (line, door.at_m)
        picture = Texture("door")
        leaf = Box(
            centre=centre,
            base_m=base,
            size_m=(door.width_m, 0.05, door.height_m),
            yaw_deg=Wall.of_room(room_by_id(door.a), side_a).yaw_deg,
            material="wood_light",
            front=picture,
            back=picture,
        )
        found += leaf.surfaces(door.a, "leaf")
    return found


def _window(window: Window) -> list[Surface]:
    room = room_by_id(window.room)
    wall = Wall.of_room(room, window.side)
    bottom = room.base_m + window.sill_m
    a, b = window.at_m - window.width_m / 2, window.at_m + window.width_m / 2
    opening = Opening(window.side, a, b, bottom, bottom + window.height_m)
    outer = wall.line_m - WALL_THICKNESS_M * sum(wall.inward)
    found = _reveal(opening, min(wall.line_m, outer), max(wall.line_m, outer), room.id, "plain_white")
    bars = _trim(wall, opening, "plain_white", with_sill=True)
    for along, width, z0, height in (
        (window.at_m, 0.05, bottom, window.height_m),
        (window.at_m, window.width_m, bottom + window.height_m * 0.68, 0.05),
    ):
        x, y, _ = wall.point(along, z0, -0.1)
        bars.append(
            Box(
                centre=(float(x), float(y)),
                base_m=z0,
                size_m=(width, 0.04, height),
                yaw_deg=wall.yaw_deg,
                material="plain_white",
            )
        )
    return found + [face for bar in bars for face in bar.surfaces(room.id, "bar")]


def stair_boxes() -> list[Box]:
    """Return the steps and the upper landing as boxes standing on the ground floor."""
    x0, _, x1, y1 = room_by_id("stair").interior
    rise = FLOOR_HEIGHT_M / STAIR_RISERS
    middle, width = (x0 + x1) / 2, x1 - x0
    steps = [
        Box(
            centre=(middle, STAIR_START_Y_M + (k + 0.5) * STAIR_TREAD_M),
            base_m=0.0,
            size_m=(width, STAIR_TREAD_M, (k + 1) * rise),
            material="concrete",
        )
        for k in range(STAIR_RISERS - 1)
    ]
    landing = STAIR_START_Y_M + (STAIR_RISERS - 1) * STAIR_TREAD_M
    steps.append(
        Box(
            centre=(middle, (landing + y1) / 2),
            base_m=0.0,
            size_m=(width, y1 - landing, FLOOR_HEIGHT_M),
            material="linoleum_grey",
        )
    )
    return steps


def _stairs() -> list[Surface]:
    found = [face for k, box in enumerate(stair_boxes()) for face in box.surfaces("stair", f"step{k}")]
    for x in (25.18, 27.82):
        for k in range(STAIR_RISERS):
            y = STAIR_START_Y_M + k * STAIR_TREAD_M
            top = (k + 1) * FLOOR_HEIGHT_M / STAIR_RISERS
            post = Box(
                centre=(x, y), base_m=min(top, FLOOR_HEIGHT_M), size_m=(0.04, 0.04, 0.9), material="metal"
            )
            found += post.surfaces("stair", f"post{k}")
    return found


def _outdoors() -> list[Surface]:
    """Return painted walls, a lawn and a sky around the building, far enough to move against the windows."""
    w, d = BUILDING_M
    far, low, high = 14.0, -0.4, 16.0
    corners = [(-far, d + far), (w + far, d + far), (w + far, -far), (-far, -far)]
    found = []
    for k in range(4):
        (xa, ya), (xb, yb) = corners[k], corners[(k + 1) % 4]
        size = (abs(xb - xa) + abs(yb - ya), high - low)
        found.append(
            Surface(
                corner=np.array([xa, ya, high]),
                right=np.array([xb - xa, yb - ya, 0]),
                down=np.array([0, 0, low - high]),
                texture=Texture("outdoors", k, size),
                room="",
                is_bright=True,
            )
        )
    span_x, span_y = w + 2 * far, d + 2 * far
    found.append(
        Surface(
            corner=np.array([-far, d + far, low]),
            right=np.array([span_x, 0, 0]),
            down=np.array([0, -span_y, 0]),
            texture=Texture("grass"),
            room="",
            is_bright=True,
        )
    )
    found.append(
        Surface(
            corner=np.array([-far, -far, high]),
            right=np.array([span_x, 0, 0]),
            down=np.array([0, span_y, 0]),
            texture=Texture("outdoors", 9, (4.0, 4.0)),
            room="",
            is_bright=True,
        )
    )
    return found
