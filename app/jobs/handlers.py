"""What a worker does with a build, for all runners."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

from app.errors import CancelledBuildError, ConflictError, NotFoundError, RoomfixError
from app.limits import limit
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.run_build import run_build
from app.storage.builds import BUILD_ID, Build, State, finish_build, recover_builds, report_progress
from app.storage.sweep import GRACE, discard_blobs, sweep_blobs, sweep_scratch

log = logging.getLogger("roomfix.jobs")


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgressOptions:
    """How often progress is written."""

    report_interval_s: float = limit(
        0.25,
        "Time between two reports of the same stage.",
        chosen="By hand: fast enough for somebody who watches, and few writes to the database.",
    )


OPTIONS = ProgressOptions()


class BuildProgress:
    """Writes a build's progress to the database and raises `CancelledBuildError` when it should stop."""

    def __init__(self, resources: Resources, build_id: str) -> None:
        self._resources = resources
        self._build_id = build_id
        self._stage = ""
        self._reported = 0.0

    def report(self, stage: str, done: int, total: int) -> None:
        """Write how far the build is, unless the last report of the same stage was a moment ago."""
        now = time.monotonic()
        if stage == self._stage and done < total and now - self._reported < OPTIONS.report_interval_s:
            return
        self._stage, self._reported = stage, now
        with self._resources.database.write() as connection:
            stop = report_progress(connection, self._build_id, stage, done, total)
        if stop:
            raise CancelledBuildError(f"Build {self._build_id} was cancelled.")


def handle_build(build: Build, resources: Resources, library: MapLibrary) -> None:
    """Run a claimed build until it has succeeded, failed or was cancelled; its errors are stored, not raised."""
    try:
        version = run_build(build, resources, library, BuildProgress(resources, build.id))
        log.info("build %s: map version %d of venue %s", build.id, version, build.venue_id)
    except CancelledBuildError:
        _finish(resources, build, "cancelled", None, None)
    except RoomfixError as error:
        _finish(resources, build, "failed", error.code, str(error))
    except Exception as error:
        log.exception("build %s failed unexpectedly", build.id)
        _finish(resources, build, "failed", "internal", f"Unexpected error: {type(error).__name__}: {error}")
    _discard_archives(resources, [build])


def recover(resources: Resources) -> None:
    """Queue the builds of a worker that died again, or end them, and remove their scratch folders.

    To be called only by a worker that knows that no other one is alive.
    """
    with resources.database.write() as connection:
        requeued, ended = recover_builds(connection)
    for build in requeued:
        log.warning("build %s lost its worker and is queued again", build.id)
    for build in ended:
        log.error("build %s lost its worker and is %s: %s", build.id, build.state, build.error or "")
    _discard_archives(resources, ended)
    for folder in resources.scratch_dir.iterdir():
        if BUILD_ID.fullmatch(folder.name):
            shutil.rmtree(folder, ignore_errors=True)


def sweep(resources: Resources, grace: timedelta = GRACE) -> None:
    """Remove blobs that nothing refers to and files that dead processes left, when they are older than `grace`.

    To be called between builds by a worker that knows that no other one is alive.
    """
    blobs = sweep_blobs(resources.database, resources.blobs, grace)
    files = sweep_scratch(resources.scratch_dir, grace)
    if blobs or files:
        log.info("swept %d blobs and %d scratch files", blobs, files)


def _discard_archives(resources: Resources, ended: Sequence[Build]) -> None:
    try:
        discard_blobs(resources.database, resources.blobs, [build.archive_blob for build in ended])
    except OSError:
        # The sweep tries again.
        log.exception("archives of ended builds could not be removed")


def _finish(resources: Resources, build: Build, state: State, code: str | None, message: str | None) -> None:
    log.info("build %s: %s %s", build.id, state, message or "")
    try:
        with resources.database.write() as connection:
            finish_build(connection, build.id, state, error_code=code, error=message)
    except (ConflictError, NotFoundError):
        # The venue was deleted while the build ran, and the build with it.
        log.info("build %s is gone", build.id)
