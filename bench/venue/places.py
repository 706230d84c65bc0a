"""Kinds of place in the demonstration building: look-alike corridors, halls that people cross, offices, galleries."""

from __future__ import annotations

from collections.abc import Mapping

from bench.venue.layout import CORRIDORS

PLACES: Mapping[str, tuple[str, ...]] = {
    "corridors": CORRIDORS,
    "halls": ("0-hall", "1-hall", "0-lobby", "1-lobby", "0-reception", "0-cafe"),
    "offices": tuple(
        f"{floor}-{key}"
        for floor in (0, 1)
        for key in ("room-1", "room-2", "room-3", "room-4", "strip-sw", "strip-se", "strip-nw", "strip-ne")
    ),
    "galleries": (
        "0-gallery-a",
        "0-gallery-b",
        "0-gallery-c",
        "1-gallery-d",
        "1-library",
        "1-lecture",
        "1-members",
    ),
}
# Restrooms, lift and stair, and doors between two kinds of place.
OTHER = "other"


def place_of(name: str) -> str:
    """Return the kind of place of a room or of a door, by an id that names its rooms; `other` for none or two."""
    found = {place for place, rooms in PLACES.items() for room in rooms if f"-{room}-" in f"-{name}-"}
    return found.pop() if len(found) == 1 else OTHER
