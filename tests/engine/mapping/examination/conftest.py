"""The scan that is examined: a part of the walk, which is enough to judge it."""

from __future__ import annotations

import pytest

from tests.scenes import Room, View, walk


@pytest.fixture(scope="session")
def views(room: Room) -> list[View]:
    """The first frames of the walk."""
    return [room.view(pose) for pose in walk()[:10]]
