"""The demonstration building as data: rooms, doors and windows of two floors in world metres (z up)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Side = Literal["N", "S", "E", "W"]

FLOOR_HEIGHT_M = 3.5
ROOM_HEIGHT_M = 2.9
WALL_THICKNESS_M = 0.2
BUILDING_M = (42.0, 26.0)
FLOOR_COUNT = 2

# The stair: treads climb towards +y inside the room "stair".
STAIR_START_Y_M = 9.3
STAIR_TREAD_M = 0.28
STAIR_RISERS = 20


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangular room; `bounds` (x0, y0, x1, y1) are the centre lines of its walls in world metres.

    Rooms that share a `look` get the same textures, lamps and posters at the same places, so that they can
    hardly be told apart. `accent` gives one wall another material.
    """

    id: str
    name: str
    floor: int
    bounds: tuple[float, float, float, float]
    wall: str
    ground: str
    ceiling: str = "ceiling_tile"
    accent: tuple[Side, str] | None = None
    art: str = "poster"
    look: str = ""
    height_m: float = ROOM_HEIGHT_M

    @property
    def interior(self) -> tuple[float, float, float, float]:
        """The walkable rectangle (x0, y0, x1, y1) between the wall faces."""
        x0, y0, x1, y1 = self.bounds
        half = WALL_THICKNESS_M / 2
        return x0 + half, y0 + half, x1 - half, y1 - half

    @property
    def base_m(self) -> float:
        """The world z of the floor."""
        return self.floor * FLOOR_HEIGHT_M

    @property
    def seed_key(self) -> str:
        """What the room's decoration is seeded with."""
        return self.look or self.id


@dataclass(frozen=True, slots=True)
class Door:
    """An opening between two rooms, centred at `at_m` along their common wall; a closed one has a leaf in
    it."""

    a: str
    b: str
    at_m: float
    floor: int = 0
    width_m: float = 1.1
    height_m: float = 2.1
    closed: bool = False


@dataclass(frozen=True, slots=True)
class Window:
    """An opening in an outer wall, centred at `at_m` along it."""

    room: str
    side: Side
    at_m: float
    width_m: float = 1.6
    sill_m: float = 0.95
    height_m: float = 1.4


def _east_rooms(floor: int, names: dict[str, str]) -> list[Room]:
    """Return the east half, its walls the same on both floors: lobby, look-alike corridors, rooms off it."""
    ground = "linoleum_grey" if floor == 0 else "linoleum_green"

    def plain(key: str, bounds: tuple[float, float, float, float], wall: str, ground: str, art: str) -> Room:
        look = "corridor" if art == "corridor" else ""
        return Room(f"{floor}-{key}", names[key], floor, bounds, wall, ground, art=art, look=look)

    return [
        plain("corridor-s", (25, 5, 42, 7.4), "plaster_cream", "linoleum_blue", "corridor"),
        plain("corridor-n", (25, 18.8, 42, 21.2), "plaster_cream", "linoleum_blue", "corridor"),
        plain("lobby", (21, 5, 25, 21.2), "plaster_sand", "terrazzo", "poster"),
        plain("lift", (25, 17, 28, 18.8), "metal", "linoleum_grey", "none"),
        plain("strip-sw", (21, 0, 33, 5), "plaster_white", "concrete", "workshop"),
        plain("strip-se", (33, 0, 42, 5), "concrete", "concrete", "workshop"),
        plain("room-1", (28, 7.4, 35, 13.1), "plaster_blue", ground, "poster"),
        plain("room-2", (35, 7.4, 42, 13.1), "plain_white", ground, "poster"),
        plain("room-3", (28, 13.1, 35, 18.8), "plaster_green", ground, "poster"),
        plain("room-4", (35, 13.1, 42, 18.8), "plain_white", ground, "sparse"),
        plain("strip-nw", (21, 21.2, 35.5, 26), "plaster_white", "linoleum_grey", "workshop"),
        plain("strip-ne", (35.5, 21.2, 42, 26), "plaster_sand", "concrete", "sparse"),
    ]


def _east_doors(floor: int) -> list[Door]:
    """Return the doors of the east half; both corridors have theirs at the same places along them."""
    p = f"{floor}-"
    return [
        Door(p + "hall", p + "lobby", 12.0, floor, 2.2, 2.4),
        Door(p + "lobby", p + "corridor-s", 6.2, floor, 1.8, 2.3),
        Door(p + "lobby", p + "corridor-n", 20.0, floor, 1.8, 2.3),
        Door(p + "lobby", p + "lift", 17.9, floor, 1.1, 2.1),
        Door(p + "corridor-s", p + "strip-sw", 30.5, floor, closed=True),
        Door(p + "corridor-s", p + "strip-se", 38.0, floor),
        Door(p + "corridor-s", p + "room-1", 32.0, floor),
        Door(p + "corridor-s", p + "room-2", 40.0, floor, closed=True),
        Door(p + "corridor-n", p + "room-3", 30.5, floor, closed=True),
        Door(p + "corridor-n", p + "room-4", 38.0, floor),
        Door(p + "corridor-n", p + "strip-nw", 32.0, floor),
        Door(p + "corridor-n", p + "strip-ne", 40.0, floor, closed=True),
        Door(p + "strip-sw", p + "strip-se", 2.5, floor),
        Door(p + "room-1", p + "room-2", 10.0, floor),
        Door(p + "room-3", p + "room-4", 16.0, floor),
        Door(p + "strip-nw", p + "strip-ne", 23.6, floor),
    ]


_GROUND_NAMES = {
    "corridor-s": "South corridor",
    "corridor-n": "North corridor",
    "lobby": "Lift lobby",
    "lift": "Lift",
    "strip-sw": "Workshop",
    "strip-se": "Storage",
    "room-1": "Study 1",
    "room-2": "Study 2",
    "room-3": "Study 3",
    "room-4": "Study 4",
    "strip-nw": "Laboratory",
    "strip-ne": "Archive",
}
_UPPER_NAMES = {
    "corridor-s": "Upper south corridor",
    "corridor-n": "Upper north corridor",
    "lobby": "Upper lobby",
    "lift": "Lift",
    "strip-sw": "Ward 1",
    "strip-se": "Ward 2",
    "room-1": "Treatment 1",
    "room-2": "Treatment 2",
    "room-3": "Treatment 3",
    "room-4": "Treatment 4",
    "strip-nw": "Ward 3",
    "strip-ne": "Linen store",
}

ROOMS: tuple[Room, ...] = (
    Room(
        "0-reception", "Reception", 0, (0, 0, 10, 8), "plaster_sand", "stone_tile", accent=("E", "wood_panel")
    ),
    Room(
        "0-gallery-a",
        "Gallery A",
        0,
        (0, 8, 10, 17),
        "plaster_white",
        "parquet_oak",
        accent=("W", "brick_red"),
        art="gallery",
    ),
    Room(
        "0-gallery-b",
        "Gallery B",
        0,
        (0, 17, 10, 26),
        "plaster_red",
        "parquet_dark",
        "ceiling_panel",
        art="gallery",
    ),
    Room(
        "0-gallery-c",
        "Gallery C",
        0,
        (10, 17, 21, 26),
        "plaster_blue",
        "carpet_grey",
        "ceiling_panel",
        accent=("E", "wallpaper"),
        art="gallery",
    ),
    Room(
        "0-hall",
        "Central hall",
        0,
        (10, 8, 21, 17),
        "plaster_cream",
        "terrazzo",
        accent=("N", "brick_white"),
        art="mixed",
    ),
    Room("0-cafe", "Cafe", 0, (10, 0, 17.5, 8), "plaster_green", "stone_check", accent=("W", "brick_red")),
    Room("0-restrooms", "Restrooms", 0, (17.5, 0, 21, 8), "wall_tile", "stone_tile", art="none"),
    Room(
        "stair",
        "Stairs",
        0,
        (25, 7.4, 28, 17),
        "plaster_white",
        "concrete",
        art="sparse",
        height_m=FLOOR_HEIGHT_M + ROOM_HEIGHT_M,
    ),
    *_east_rooms(0, _GROUND_NAMES),
    Room(
        "1-library", "Library", 1, (0, 0, 10, 13), "plaster_green", "carpet_red", accent=("W", "wood_panel")
    ),
    Room(
        "1-lecture",
        "Lecture room",
        1,
        (0, 13, 10, 26),
        "plaster_white",
        "carpet_grey",
        "ceiling_panel",
        accent=("N", "wood_panel"),
        art="sparse",
    ),
    Room(
        "1-gallery-d",
        "Gallery D",
        1,
        (10, 17, 21, 26),
        "plaster_sand",
        "parquet_oak",
        accent=("N", "brick_white"),
        art="gallery",
    ),
    Room(
        "1-hall",
        "Upper hall",
        1,
        (10, 8, 21, 17),
        "plaster_blue",
        "stone_tile",
        accent=("S", "brick_red"),
        art="mixed",
    ),
    Room("1-members", "Members' room", 1, (10, 0, 17.5, 8), "wallpaper", "parquet_dark", art="gallery"),
    Room("1-restrooms", "Restrooms", 1, (17.5, 0, 21, 8), "wall_tile", "stone_tile", art="none"),
    *_east_rooms(1, _UPPER_NAMES),
)

DOORS: tuple[Door, ...] = (
    Door("0-reception", "0-gallery-a", 3.0, 0, 2.4, 2.4),
    Door("0-reception", "0-cafe", 5.6, 0, 1.6),
    Door("0-gallery-a", "0-gallery-b", 7.0, 0, 1.6, 2.3),
    Door("0-gallery-a", "0-hall", 12.5, 0, 2.0, 2.4),
    Door("0-gallery-b", "0-gallery-c", 23.0, 0, 1.6, 2.3),
    Door("0-hall", "0-gallery-c", 14.0, 0, 1.8, 2.3),
    Door("0-cafe", "0-hall", 14.5, 0, 1.6),
    Door("0-restrooms", "0-hall", 19.0, 0, 1.0),
    Door("0-lobby", "stair", 8.3, 0, 1.4),
    *_east_doors(0),
    Door("1-lobby", "stair", 15.8, 1, 1.4),
    Door("1-library", "1-lecture", 5.0, 1, 1.4),
    Door("1-library", "1-hall", 10.5, 1, 1.6, 2.3),
    Door("1-library", "1-members", 4.0, 1, 1.2),
    Door("1-lecture", "1-gallery-d", 21.5, 1, 1.4),
    Door("1-hall", "1-gallery-d", 15.5, 1, 2.0, 2.3),
    Door("1-members", "1-hall", 13.0, 1, 1.2),
    Door("1-restrooms", "1-hall", 19.0, 1, 1.0),
    *_east_doors(1),
)

_WINDOW_PLACES: tuple[tuple[str, Side, tuple[float, ...]], ...] = (
    ("0-reception", "S", (2.0, 7.2)),
    ("0-reception", "W", (4.0,)),
    ("0-gallery-b", "N", (7.5,)),
    ("0-cafe", "S", (12.0, 15.2)),
    ("0-strip-sw", "S", (24.0, 29.0)),
    ("0-room-2", "E", (10.0,)),
    ("0-strip-nw", "N", (25.0, 31.0)),
    ("1-library", "S", (2.5, 7.5)),
    ("1-library", "W", (9.5,)),
    ("1-lecture", "W", (16.0, 19.5, 23.0)),
    ("1-members", "S", (12.0, 15.5)),
    ("1-strip-sw", "S", (24.0, 29.0)),
    ("1-strip-se", "S", (37.5,)),
    ("1-room-2", "E", (10.0,)),
    ("1-strip-nw", "N", (25.0, 31.0)),
)
WINDOWS: tuple[Window, ...] = tuple(
    Window(room, side, at) for room, side, ats in _WINDOW_PLACES for at in ats
)

# The rooms of the main wing: what `render_wing` scans.
WING_ROOMS = ("0-reception", "0-gallery-a", "0-gallery-b", "0-gallery-c", "0-hall", "0-cafe")
CORRIDORS = ("0-corridor-s", "0-corridor-n", "1-corridor-s", "1-corridor-n")

_ROOM_BY_ID = {room.id: room for room in ROOMS}


def room_by_id(room_id: str) -> Room:
    """Return the room of an id."""
    return _ROOM_BY_ID[room_id]


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


def room_at(x_m: float, y_m: float, floor: int) -> Room | None:
    """Return the room of a floor whose walls' centre lines enclose a world point (the stair is on both
    floors)."""
    for room in ROOMS:
        x0, y0, x1, y1 = room.bounds
        if (room.floor == floor or room.id == "stair") and x0 <= x_m < x1 and y0 <= y_m < y1:
            return room
    return None
