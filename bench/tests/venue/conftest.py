"""Small parts of the demonstration building, since the whole takes long to prepare."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.render.scene import Scene, build_scene
from bench.render.surfaces import Surface
from bench.venue.building import shell
from bench.venue.decor import decoration
from bench.venue.layout import CORRIDORS


@pytest.fixture(scope="session")
def surfaces() -> list[Surface]:
    return shell() + decoration()


@pytest.fixture(scope="session")
def outline(surfaces: list[Surface]) -> Scene:
    """The whole building with one texture everywhere: for what asks where rays end. To draw all takes ten seconds."""
    pytest.importorskip("embreex")
    return build_scene([replace(each, texture=surfaces[0].texture) for each in surfaces])


@pytest.fixture(scope="session")
def gallery(surfaces: list[Surface]) -> Scene:
    return build_scene([s for s in surfaces if s.room == "0-gallery-a"])


@pytest.fixture(scope="session")
def corridors(surfaces: list[Surface]) -> Scene:
    return build_scene([s for s in surfaces if s.room in CORRIDORS])
