"""Kinds of place of the demonstration building."""

from __future__ import annotations

import pytest

from bench.venue.layout import ROOMS
from bench.venue.places import OTHER, PLACES, place_of


def test_places_name_rooms_once() -> None:
    named = [room for rooms in PLACES.values() for room in rooms]
    assert len(named) == len(set(named))
    assert set(named) <= {room.id for room in ROOMS}
    left = {room.id for room in ROOMS} - set(named)
    assert left == {"stair", "0-lift", "1-lift", "0-restrooms", "1-restrooms"}


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("1-library", "galleries"),
        ("door-0-room-3-0-room-4-0", "offices"),
        ("door-1-corridor-s-1-room-1-1", OTHER),
        ("0-restrooms", OTHER),
    ],
)
def test_rooms_and_doors_have_a_place(name: str, place: str) -> None:
    assert place_of(name) == place
