"""Builds that several workers of one data folder make together: one of them owns the build, the others help it."""

from __future__ import annotations

import logging
import shutil
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from app.errors import CancelledBuildError, NotFoundError
from app.limits import limit
from app.services.builds.run_build import make_map, scratch, scratch_folder
from app.services.builds.shared_work import SharedExecutor
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.builds import Build, get_build
from app.storage.leases import list_leases

log = logging.getLogger("roomfix.jobs")


@dataclass(frozen=True, slots=True, kw_only=True)
class SharingOptions:
    """How a helper follows the build."""

    check_s: float = limit(
        1.0,
        "Time between two checks of a helper whether the build still runs.",
        chosen="By hand: little is done in vain, and the database isn't asked for each frame.",
    )


OPTIONS = SharingOptions()


@contextmanager
def shared(resources: Resources, build: Build) -> Iterator[Resources]:
    """Give the resources with which a build is run, by its owner: where builds are shared, others can help it.

    What was made is kept when the process dies, for the next attempt.
    """
    if not resources.settings.share_builds:
        yield resources
        return
    parts = parts_folder(resources, build.id)
    parts.mkdir(parents=True, exist_ok=True)
    try:
        with _sharing(resources, build.id, scratch_folder(resources, build)) as own:
            yield own
    finally:
        shutil.rmtree(parts, ignore_errors=True)


def parts_folder(resources: Resources, build_id: str) -> Path:
    """Return the folder of the results that the workers of a build share."""
    return resources.scratch_dir / f"{build_id}-parts"


class Helper:
    """Helps builds of other workers on the same data folder. Each attempt at a build is helped once."""

    def __init__(self, resources: Resources, library: MapLibrary, stop: threading.Event) -> None:
        self._resources, self._library, self._stop = resources, library, stop
        self._helped: set[tuple[str, int]] = set()

    def help_one(self) -> bool:
        """Help a build that runs elsewhere until all its heavy work is done; return whether there was one."""
        if not self._resources.settings.share_builds:
            return False
        with self._resources.database.read() as connection:
            running = [lease.build_id for lease in list_leases(connection)]
        for build_id in running:
            build = _build(self._resources, build_id)
            if build is None or (build.id, build.attempts) in self._helped:
                continue
            if parts_folder(self._resources, build.id).is_dir():
                self._helped.add((build.id, build.attempts))
                self._help(build)
                return True
        return False

    def _help(self, build: Build) -> None:
        log.info("helping with build %s of venue %s", build.id, build.venue_id)
        folder = self._resources.scratch_dir / f"{build.id}-help-{uuid.uuid4().hex}"
        progress = _Following(self._resources, build, self._stop)
        try:
            with _sharing(self._resources, build.id, folder) as own, scratch(folder):
                make_map(build, own, self._library, progress, folder)
        except CancelledBuildError:
            log.info("build %s needs no help any more", build.id)
        except Exception as error:
            # Its owner meets the same error, and reports it.
            log.info("help with build %s ended: %s", build.id, error)


def _build(resources: Resources, build_id: str) -> Build | None:
    """Return a build, None for one that was deleted with its venue."""
    try:
        with resources.database.read() as connection:
            return get_build(connection, build_id)
    except NotFoundError:
        return None


@contextmanager
def _sharing(resources: Resources, build_id: str, folder: Path) -> Iterator[Resources]:
    executor = SharedExecutor(parts_folder(resources, build_id), folder, resources.settings.workers)
    try:
        yield replace(resources, executor=executor)
    finally:
        executor.shutdown(cancel_futures=True)


class _Following:
    """Raises `CancelledBuildError` when a build doesn't run any more as it did, or the process stops."""

    def __init__(self, resources: Resources, build: Build, stop: threading.Event) -> None:
        self._resources, self._build, self._stop = resources, build, stop
        self._checked = time.monotonic()

    def report(self, stage: str, done: int, total: int) -> None:
        """Check the build, unless that was done a moment ago; its owner reports the progress."""
        now = time.monotonic()
        if now - self._checked < OPTIONS.check_s and not self._stop.is_set():
            return
        self._checked = now
        if self._stop.is_set() or not self._runs():
            raise CancelledBuildError(
                f"Build {self._build.id} needs no help after {done} of {total} in {stage!r}."
            )

    def _runs(self) -> bool:
        found = _build(self._resources, self._build.id)
        if found is None:
            return False
        same = (found.worker, found.attempts) == (self._build.worker, self._build.attempts)
        return found.state == "running" and same
