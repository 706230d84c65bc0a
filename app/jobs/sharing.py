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
from app.services.builds.run_build import SCAN, linked_scan, make_map, scratch, scratch_folder
from app.services.builds.shared_work import SharedExecutor
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.storage.builds import Build, count_queued, get_build
from app.storage.leases import list_leases

log = logging.getLogger("roomfix.jobs")
# The end of the name of a folder of shared results.
PARTS = "-parts"


@dataclass(frozen=True, slots=True, kw_only=True)
class SharingOptions:
    """How a helper finds a build and follows it."""

    look_s: float = limit(
        0.2,
        "Time between two looks of an idle worker for a build that is shared.",
        chosen="By hand: a listing of one folder. What is missed at the start of a build is made by its owner alone.",
    )
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
    return resources.scratch_dir / f"{build_id}{PARTS}"


def shared_builds(resources: Resources) -> set[str]:
    """Return the ids of the builds that workers of this data folder share."""
    return {folder.name.removesuffix(PARTS) for folder in resources.scratch_dir.glob(f"*{PARTS}")}


class Helper:
    """Helps builds of other workers on the same data folder. Each attempt at a build is helped once."""

    def __init__(self, resources: Resources, library: MapLibrary, stop: threading.Event) -> None:
        self._resources, self._library, self._stop = resources, library, stop
        self._helped: set[tuple[str, int]] = set()
        self._seen: set[str] = set()

    def help_one(self) -> bool:
        """Help a build that runs elsewhere until all its heavy work is done, or a build waits that this worker takes;
        return whether there was one."""
        if not self._resources.settings.share_builds:
            return False
        with self._resources.database.read() as connection:
            running = [lease.build_id for lease in list_leases(connection)]
        for build_id in running:
            build = _build(self._resources, build_id)
            if build is None or (build.id, build.attempts) in self._helped:
                continue
            if parts_folder(self._resources, build.id).is_dir():
                # A build that was left for one of this worker's own is helped again after that.
                if self._help(build):
                    self._helped.add((build.id, build.attempts))
                return True
        return False

    def wait(self, wake: threading.Event, seconds: float) -> None:
        """Wait until woken, or until another worker of the data folder begins to share a build."""
        if not self._resources.settings.share_builds:
            wake.wait(seconds)
            return
        until = time.monotonic() + seconds
        while not wake.wait(OPTIONS.look_s) and time.monotonic() < until:
            before, self._seen = self._seen, shared_builds(self._resources)
            if self._seen - before:
                return

    def _help(self, build: Build) -> bool:
        """Help a build; return whether it needs no more help."""
        log.info("helping with build %s of venue %s", build.id, build.venue_id)
        folder = self._resources.scratch_dir / f"{build.id}-help-{uuid.uuid4().hex}"
        progress = _Following(self._resources, build, self._stop)
        try:
            with _sharing(self._resources, build.id, folder) as own, scratch(folder):
                root = self._scan_of(build, progress, folder)
                make_map(build, own, self._library, progress, folder, root)
        except CancelledBuildError as error:
            log.info("%s", error)
        except Exception as error:
            # Its owner meets the same error, and reports it.
            log.info("help with build %s ended: %s", build.id, error)
        return not progress.is_called_away

    def _scan_of(self, build: Build, progress: _Following, folder: Path) -> Path | None:
        """Return the scan that the owner has unpacked, once it has; None where its files can't be linked."""
        unpacked = scratch_folder(self._resources, build)
        try:
            while (root := linked_scan(unpacked, folder)) is None:
                progress.report("unpack", 0, 1)
                self._stop.wait(OPTIONS.look_s)
        except OSError as error:
            log.debug("the scan of build %s is unpacked once more: %s", build.id, error)
            shutil.rmtree(folder / SCAN, ignore_errors=True)
            return None
        return root


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
    """Raises `CancelledBuildError` when a build doesn't run any more as it did, another one waits for this worker, or
    the process stops."""

    def __init__(self, resources: Resources, build: Build, stop: threading.Event) -> None:
        self._resources, self._build, self._stop = resources, build, stop
        self._checked = time.monotonic()
        self.is_called_away = False

    def report(self, stage: str, done: int, total: int) -> None:
        """Check the build, unless that was done a moment ago; its owner reports the progress."""
        now = time.monotonic()
        if now - self._checked < OPTIONS.check_s and not self._stop.is_set():
            return
        self._checked = now
        where = f"after {done} of {total} in {stage!r}"
        if self._stop.is_set() or not self._runs():
            raise CancelledBuildError(f"build {self._build.id} needs no help any more {where}")
        if self._is_awaited():
            self.is_called_away = True
            raise CancelledBuildError(
                f"build {self._build.id} is left to its owner {where}: another one waits"
            )

    def _is_awaited(self) -> bool:
        with self._resources.database.read() as connection:
            queued = count_queued(connection)
        return any(queued[kind] for kind in self._resources.settings.kinds_of_builds)

    def _runs(self) -> bool:
        found = _build(self._resources, self._build.id)
        if found is None:
            return False
        same = (found.worker, found.attempts) == (self._build.worker, self._build.attempts)
        return found.state == "running" and same
