"""A build whose map is made once for many tests of the steps around it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from app.services.builds.place_scan import PresentMap
from app.services.builds.run_build import MadeMap
from app.services.builds.shared_work import SharedExecutor
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.settings import Settings
from app.storage.builds import Build, claim_build
from app.storage.maps import KeyframeImages, list_keyframe_images, list_left_out
from tests.scenes import CAMERA_TEXT

OPTIONS = {"camera": CAMERA_TEXT, "refine_depth": False, "second_features": False}
# Stages that are reported, with how much is done of how much.
Reports = list[tuple[str, int, int]]


class Noted:
    """Progress that notes what is reported, and does something at a stage."""

    def __init__(self, stage: str = "", action: Callable[[], object] = lambda: None) -> None:
        self.reports: Reports = []
        self._stage, self._action = stage, action

    def report(self, stage: str, done: int, total: int) -> None:
        self.reports.append((stage, done, total))
        if stage == self._stage:
            self._action()


class Inline(SharedExecutor):
    """Makes each call at once, and notes what results are stated to depend on."""

    def __init__(self) -> None:
        self.stated: list[tuple[object, ...]] = []

    def depend_on(self, *values: object) -> None:
        self.stated.append(values)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Nothing runs."""


@dataclass(frozen=True)
class Prepared:
    """A data folder with a venue and a queued build, and the map that this build makes; its scan stays unpacked."""

    data_dir: Path
    made: MadeMap
    root: Path


def opened(data_dir: Path) -> Resources:
    return Resources.open(Settings(_env_file=None, data_dir=data_dir, open=True, workers=1))


def claimed(resources: Resources, worker: str = "") -> Build:
    with resources.database.write() as connection:
        build = claim_build(connection, worker)
    assert build is not None
    return build


def with_options(made: MadeMap, **options: Any) -> MadeMap:
    return replace(made, examined=replace(made.examined, options=replace(made.examined.options, **options)))


def extending(made: MadeMap, resources: Resources, **options: Any) -> MadeMap:
    """Return the map as one that extends what serves."""
    found = MapLibrary(resources).active("v")
    assert found is not None
    return replace(with_options(made, mode="extend", **options), present=PresentMap(*found, ()))


def pictures(resources: Resources, version: int) -> list[KeyframeImages]:
    with resources.database.read() as connection:
        return list_keyframe_images(connection, "v", version)


def left_out(resources: Resources, version: int) -> list[str]:
    with resources.database.read() as connection:
        return [frame.name for frame in list_left_out(connection, "v", version)]
