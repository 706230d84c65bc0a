"""The real rooms that pipelines are compared in, and how each is split into map and queries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from app.engine.mapping.options import parse_build_options
from app.errors import InvalidInputError
from bench.evaluation.dataset import Split, split_scan

# What the kinds of splits are, in the order of tables.
KINDS = {
    "between": "Queries from between the map's frames",
    "unseen": "Queries from a part of the room that the map's frames left",
    "few": "A map of few keyframes",
}


@dataclass(frozen=True, slots=True)
class RoomSplit:
    """Frames of the map and of the queries (`start:stop:step`), and which of `KINDS` the split is."""

    kind: str
    database: str
    queries: str

    @property
    def name(self) -> str:
        """The split as the commands write it."""
        return f"{self.kind} {self.database} / {self.queries}"


@dataclass(frozen=True, slots=True)
class Room:
    """A scan in a folder, its splits, the options that it is built with, and the limits that were chosen on it."""

    folder: str
    splits: tuple[RoomSplit, ...]
    options: Mapping[str, Any] = field(default_factory=dict)
    decided: str = "none"


KITCHEN_CAMERA = [525.505, 525.505, 320, 240]
FREIBURG1_CAMERA = [517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633]

ROOMS = (
    Room(
        "redkitchen",
        (
            RoomSplit("between", "0::2", "1::10"),
            RoomSplit("unseen", "0:300", "300::3"),
            RoomSplit("unseen", "200:500", "0:200:2"),
            RoomSplit("few", "0:100", "100::5"),
            RoomSplit("few", "450:500", "0:450:5"),
        ),
        {"camera": KITCHEN_CAMERA, "depth_scale": 1000},
        "how much is retrieved and matched; contradiction; wrong cameras; the confidence",
    ),
    Room(
        "desk_rs",
        (
            RoomSplit("between", "0::2", "1::4"),
            RoomSplit("unseen", "0:60", "60::3"),
            RoomSplit("unseen", "120:", "0:120:2"),
            RoomSplit("few", "0:20", "20::4"),
            RoomSplit("few", "170:", "0:170:4"),
        ),
        {"depth_scale": 1000},
        "all limits of the second look; wrong cameras",
    ),
    Room(
        "tum_fr1_rpy",
        (
            RoomSplit("between", "0::2", "1::2"),
            RoomSplit("unseen", "0:40", "40::2"),
            RoomSplit("unseen", "70:", "0:70:2"),
            RoomSplit("few", "0:15", "15::2"),
        ),
        {"camera": FREIBURG1_CAMERA, "depth_scale": 5000},
        "contradiction; wrong cameras; the confidence",
    ),
)


def rooms_in(data: Path, names: Sequence[str], kinds: Sequence[str] = ()) -> list[Room]:
    """Return the rooms of these names that a folder holds, with their splits of these kinds; by default all.

    Raises `InvalidInputError` for other names and kinds.
    """
    known = {room.folder: room for room in ROOMS}
    for name in names:
        if name not in known or not (data / name).is_dir():
            raise InvalidInputError(f"{data} has no room {name!r}; rooms are {', '.join(known)}.")
    for kind in kinds:
        if kind not in KINDS:
            raise InvalidInputError(f"Splits of kind {kind!r} are not known; use {', '.join(KINDS)}.")
    found = [room for room in ROOMS if (room.folder in names or not names) and (data / room.folder).is_dir()]
    if not found:
        raise InvalidInputError(f"{data} holds none of the rooms {', '.join(known)}.")
    return [
        replace(room, splits=tuple(split for split in room.splits if split.kind in (kinds or KINDS)))
        for room in found
    ]


def open_split(data: Path, room: Room, split: RoomSplit) -> Split:
    """Open a room's scan and split it."""
    options = parse_build_options(dict(room.options))
    return split_scan(data / room.folder, split.database, split.queries, options.format, options.scan)
