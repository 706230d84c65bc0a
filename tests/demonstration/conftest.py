"""Small parts of the demonstration building, since the whole takes long to prepare."""

from __future__ import annotations

import pytest

from app.demonstration.building import shell
from app.demonstration.decor import decoration
from app.demonstration.layout import CORRIDORS
from app.demonstration.scene import Scene, build_scene
from app.demonstration.surfaces import Surface


@pytest.fixture(scope="session")
def surfaces() -> list[Surface]:
    return shell() + decoration()


@pytest.fixture(scope="session")
def gallery(surfaces: list[Surface]) -> Scene:
    return build_scene([s for s in surfaces if s.room == "0-gallery-a"])


@pytest.fixture(scope="session")
def corridors(surfaces: list[Surface]) -> Scene:
    return build_scene([s for s in surfaces if s.room in CORRIDORS])
