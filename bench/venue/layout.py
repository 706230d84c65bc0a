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


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """A rectangular room; `bounds` (x0, y0, x1, y1) are the centre lines of its walls in world metres.

    Rooms that share a `look` get the same textures, lamps and posters at the same places, so that they can
    hardly be distinguished. `accent` gives one wall another material.
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


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True, kw_only=True)
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
        return Room(
            id=f"{floor}-{key}",
            name=names[key],
            floor=floor,
            bounds=bounds,
            wall=wall,
            ground=ground,
            art=art,
            look=look,
        )

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
        Door(a=p + "hall", b=p + "lobby", at_m=12.0, floor=floor, width_m=2.2, height_m=2.4),
        Door(a=p + "lobby", b=p + "corridor-s", at_m=6.2, floor=floor, width_m=1.8, height_m=2.3),
        Door(a=p + "lobby", b=p + "corridor-n", at_m=20.0, floor=floor, width_m=1.8, height_m=2.3),
        Door(a=p + "lobby", b=p + "lift", at_m=17.9, floor=floor, width_m=1.1, height_m=2.1),
        Door(a=p + "corridor-s", b=p + "strip-sw", at_m=30.5, floor=floor, closed=True),
        Door(a=p + "corridor-s", b=p + "strip-se", at_m=38.0, floor=floor),
        Door(a=p + "corridor-s", b=p + "room-1", at_m=32.0, floor=floor),
        Door(a=p + "corridor-s", b=p + "room-2", at_m=40.0, floor=floor, closed=True),
        Door(a=p + "corridor-n", b=p + "room-3", at_m=30.5, floor=floor, closed=True),
        Door(a=p + "corridor-n", b=p + "room-4", at_m=38.0, floor=floor),
        Door(a=p + "corridor-n", b=p + "strip-nw", at_m=32.0, floor=floor),
        Door(a=p + "corridor-n", b=p + "strip-ne", at_m=40.0, floor=floor, closed=True),
        Door(a=p + "strip-sw", b=p + "strip-se", at_m=2.5, floor=floor),
        Door(a=p + "room-1", b=p + "room-2", at_m=10.0, floor=floor),
        Door(a=p + "room-3", b=p + "room-4", at_m=16.0, floor=floor),
        Door(a=p + "strip-nw", b=p + "strip-ne", at_m=23.6, floor=floor),
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
        id="0-reception",
        name="Reception",
        floor=0,
        bounds=(0, 0, 10, 8),
        wall="plaster_sand",
        ground="stone_tile",
        accent=("E", "wood_panel"),
    ),
    Room(
        id="0-gallery-a",
        name="Gallery A",
        floor=0,
        bounds=(0, 8, 10, 17),
        wall="plaster_white",
        ground="parquet_oak",
        accent=("W", "brick_red"),
        art="gallery",
    ),
    Room(
        id="0-gallery-b",
        name="Gallery B",
        floor=0,
        bounds=(0, 17, 10, 26),
        wall="plaster_red",
        ground="parquet_dark",
        ceiling="ceiling_panel",
        art="gallery",
    ),
    Room(
        id="0-gallery-c",
        name="Gallery C",
        floor=0,
        bounds=(10, 17, 21, 26),
        wall="plaster_blue",
        ground="carpet_grey",
        ceiling="ceiling_panel",
        accent=("E", "wallpaper"),
        art="gallery",
    ),
    Room(
        id="0-hall",
        name="Central hall",
        floor=0,
        bounds=(10, 8, 21, 17),
        wall="plaster_cream",
        ground="terrazzo",
        accent=("N", "brick_white"),
        art="mixed",
    ),
    Room(
        id="0-cafe",
        name="Cafe",
        floor=0,
        bounds=(10, 0, 17.5, 8),
        wall="plaster_green",
        ground="stone_check",
        accent=("W", "brick_red"),
    ),
    Room(
        id="0-restrooms",
        name="Restrooms",
        floor=0,
        bounds=(17.5, 0, 21, 8),
        wall="wall_tile",
        ground="stone_tile",
        art="none",
    ),
    Room(
        id="stair",
        name="Stairs",
        floor=0,
        bounds=(25, 7.4, 28, 17),
        wall="plaster_white",
        ground="concrete",
        art="sparse",
        height_m=FLOOR_HEIGHT_M + ROOM_HEIGHT_M,
    ),
    *_east_rooms(0, _GROUND_NAMES),
    Room(
        id="1-library",
        name="Library",
        floor=1,
        bounds=(0, 0, 10, 13),
        wall="plaster_green",
        ground="carpet_red",
        accent=("W", "wood_panel"),
    ),
    Room(
        id="1-lecture",
        name="Lecture room",
        floor=1,
        bounds=(0, 13, 10, 26),
        wall="plaster_white",
        ground="carpet_grey",
        ceiling="ceiling_panel",
        accent=("N", "wood_panel"),
        art="sparse",
    ),
    Room(
        id="1-gallery-d",
        name="Gallery D",
        floor=1,
        bounds=(10, 17, 21, 26),
        wall="plaster_sand",
        ground="parquet_oak",
        accent=("N", "brick_white"),
        art="gallery",
    ),
    Room(
        id="1-hall",
        name="Upper hall",
        floor=1,
        bounds=(10, 8, 21, 17),
        wall="plaster_blue",
        ground="stone_tile",
        accent=("S", "brick_red"),
        art="mixed",
    ),
    Room(
        id="1-members",
        name="Members' room",
        floor=1,
        bounds=(10, 0, 17.5, 8),
        wall="wallpaper",
        ground="parquet_dark",
        art="gallery",
    ),
    Room(
        id="1-restrooms",
        name="Restrooms",
        floor=1,
        bounds=(17.5, 0, 21, 8),
        wall="wall_tile",
        ground="stone_tile",
        art="none",
    ),
    *_east_rooms(1, _UPPER_NAMES),
)

DOORS: tuple[Door, ...] = (
    Door(a="0-reception", b="0-gallery-a", at_m=3.0, floor=0, width_m=2.4, height_m=2.4),
    Door(a="0-reception", b="0-cafe", at_m=5.6, floor=0, width_m=1.6),
    Door(a="0-gallery-a", b="0-gallery-b", at_m=7.0, floor=0, width_m=1.6, height_m=2.3),
    Door(a="0-gallery-a", b="0-hall", at_m=12.5, floor=0, width_m=2.0, height_m=2.4),
    Door(a="0-gallery-b", b="0-gallery-c", at_m=23.0, floor=0, width_m=1.6, height_m=2.3),
    Door(a="0-hall", b="0-gallery-c", at_m=14.0, floor=0, width_m=1.8, height_m=2.3),
    Door(a="0-cafe", b="0-hall", at_m=14.5, floor=0, width_m=1.6),
    Door(a="0-restrooms", b="0-hall", at_m=19.0, floor=0, width_m=1.0),
    Door(a="0-lobby", b="stair", at_m=8.3, floor=0, width_m=1.4),
    *_east_doors(0),
    Door(a="1-lobby", b="stair", at_m=15.8, floor=1, width_m=1.4),
    Door(a="1-library", b="1-lecture", at_m=5.0, floor=1, width_m=1.4),
    Door(a="1-library", b="1-hall", at_m=10.5, floor=1, width_m=1.6, height_m=2.3),
    Door(a="1-library", b="1-members", at_m=4.0, floor=1, width_m=1.2),
    Door(a="1-lecture", b="1-gallery-d", at_m=21.5, floor=1, width_m=1.4),
    Door(a="1-hall", b="1-gallery-d", at_m=15.5, floor=1, width_m=2.0, height_m=2.3),
    Door(a="1-members", b="1-hall", at_m=13.0, floor=1, width_m=1.2),
    Door(a="1-restrooms", b="1-hall", at_m=19.0, floor=1, width_m=1.0),
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
    Window(room=room, side=side, at_m=at) for room, side, ats in _WINDOW_PLACES for at in ats
)

# The rooms of the main wing: what `render_wing` scans.
WING_ROOMS = ("0-reception", "0-gallery-a", "0-gallery-b", "0-gallery-c", "0-hall", "0-cafe")
CORRIDORS = ("0-corridor-s", "0-corridor-n", "1-corridor-s", "1-corridor-n")

_ROOM_BY_ID = {room.id: room for room in ROOMS}


def room_by_id(room_id: str) -> Room:
    """Return the room of an id."""
    return _ROOM_BY_ID[room_id]


def room_at(x_m: float, y_m: float, floor: int) -> Room | None:
    """Return the room of a floor whose walls' centre lines enclose a world point (the stair is on both
    floors)."""
    for room in ROOMS:
        x0, y0, x1, y1 = room.bounds
        if (room.floor == floor or room.id == "stair") and x0 <= x_m < x1 and y0 <= y_m < y1:
            return room
    return None
