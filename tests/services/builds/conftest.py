"""A map that is made once, and a venue of its own for each test with the build that makes it."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app.engine.progress import NoProgress
from app.services.builds import run_build as module
from app.services.builds.run_build import MadeMap, make_map, run_build, scratch, unpack
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.storage.builds import get_build
from app.storage.maps import get_map
from app.storage.venues import create_venue
from tests.made_map import (
    OPTIONS,
    Noted,
    Prepared,
    claimed,
    opened,
)
from tests.scenes import View, scan_files, zipped


@pytest.fixture(scope="session")
def prepared(views: list[View], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prepared]:
    """A scan of three frames that become keyframes and one that is too dark."""
    folder = tmp_path_factory.mktemp("made")
    resources = opened(folder / "data")
    with resources.database.write() as connection:
        create_venue(connection, "v", "V")
    dark = View(views[4].world_from_camera, views[4].rgb // 60, views[4].depth_m)
    submit_build(resources, "v", OPTIONS, io.BytesIO(zipped(scan_files([*views[:3], dark]))))
    kept = folder / "kept"
    shutil.copytree(folder / "data", kept)
    build = claimed(resources)
    with scratch(folder / "scratch") as unpacked:
        root = unpack(build, resources, unpacked, NoProgress())
        made = make_map(build, resources, MapLibrary(resources), NoProgress(), unpacked, root)
        yield Prepared(kept, made, root)
    resources.close()


@pytest.fixture
def resources(prepared: Prepared, tmp_path: Path) -> Iterator[Resources]:
    """A venue of its own with the queued build."""
    shutil.copytree(prepared.data_dir, tmp_path, dirs_exist_ok=True)
    found = opened(tmp_path)
    yield found
    found.close()


@pytest.fixture
def made(prepared: Prepared) -> MadeMap:
    """The map, whose times are this test's alone."""
    return replace(prepared.made, seconds=dict(prepared.made.seconds))


@pytest.fixture
def publish(
    resources: Resources, made: MadeMap, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., dict[str, Any]]:
    """Runs a build whose map is made already, and returns the report of the version; the build is claimed anew."""

    def run(
        found: MadeMap | None = None, progress: Noted | None = None, worker: str = "w", queued: bool = True
    ) -> dict[str, Any]:
        if not queued:
            submit_build(resources, "v", OPTIONS, io.BytesIO(zipped({"rgb.txt": b"#"})))
        build = claimed(resources, worker)
        given = made if found is None else found
        with monkeypatch.context() as patched:
            patched.setattr(module, "make_map", lambda *_: given)
            version = run_build(build, resources, MapLibrary(resources), progress or Noted())
        with resources.database.read() as connection:
            ended, published = get_build(connection, build.id), get_map(connection, "v", version)
        assert (ended.state, ended.map_version, ended.report) == ("succeeded", version, published.statistics)
        return published.statistics

    return run
