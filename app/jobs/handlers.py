"""What a worker does with a build, for all runners."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

from app.errors import CancelledBuildError, ConflictError, NotFoundError, RoomfixError
from app.jobs.lease import LeaseWatch
from app.jobs.sharing import shared
from app.limits import limit
from app.services.builds.run_build import run_build, scratch_folder
from app.services.map_library import MapLibrary
from app.services.recordings.service import drop_old_recordings
from app.services.resources import Resources
from app.storage.builds import Build, State, finish_build, report_progress
from app.storage.leases import list_leases, take_back
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

    def __init__(self, resources: Resources, build: Build) -> None:
        self._resources = resources
        self._build = build
        self._stage = ""
        self._reported = 0.0

    def report(self, stage: str, done: int, total: int) -> None:
        """Write how far the build is, unless the last report of the same stage was a moment ago."""
        now = time.monotonic()
        if stage == self._stage and done < total and now - self._reported < OPTIONS.report_interval_s:
            return
        self._stage, self._reported = stage, now
        with self._resources.database.write() as connection:
            stop = report_progress(connection, self._build.id, stage, done, total, self._build.worker or "")
        if stop:
            raise CancelledBuildError(f"Build {self._build.id} was cancelled.")


def handle_build(build: Build, resources: Resources, library: MapLibrary) -> None:
    """Run a claimed build until it has succeeded, failed or was cancelled; its errors are stored, not raised."""
    try:
        with shared(resources, build) as own:
            version = run_build(build, own, library, BuildProgress(resources, build))
        log.info("build %s: map version %d of venue %s", build.id, version, build.venue_id)
    except CancelledBuildError:
        _finish(resources, build, "cancelled", None, None)
    except RoomfixError as error:
        _finish(resources, build, "failed", error.code, str(error))
    except Exception as error:
        log.exception("build %s failed unexpectedly", build.id)
        _finish(resources, build, "failed", "internal", f"Unexpected error: {type(error).__name__}: {error}")
    _discard_archives(resources, [build])


def recover(resources: Resources, watch: LeaseWatch) -> None:
    """Queue the builds of dead workers again, or end them, and remove the scratch folders of what doesn't run here."""
    with resources.database.read() as connection:
        dead = watch.run_out(list_leases(connection))
    taken = []
    for lease in dead:
        with resources.database.write() as connection:
            build = take_back(connection, lease)
        if build is None:
            continue
        taken.append(build)
        level = logging.ERROR if build.ended else logging.WARNING
        log.log(level, "build %s lost its worker and is %s: %s", build.id, build.state, build.error or "")
    if taken:
        _discard_archives(resources, [build for build in taken if build.ended])
        remove_scratch(resources, taken)


def remove_scratch(resources: Resources, taken: Sequence[Build]) -> None:
    """Remove the scratch folders of the attempts that builds were taken from; another worker may make the next one."""
    for build in taken:
        shutil.rmtree(scratch_folder(resources, build), ignore_errors=True)


def sweep(resources: Resources, grace: timedelta = GRACE) -> None:
    """Remove recordings that were given up, and blobs that nothing refers to and files that dead processes left, when
    they are older than `grace`."""
    with resources.database.read() as connection:
        running = {lease.build_id for lease in list_leases(connection)}
    drop_old_recordings(resources)
    blobs = sweep_blobs(resources.database, resources.blobs, grace)
    files = sweep_scratch(resources.scratch_dir, grace, running)
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
            finish_build(
                connection, build.id, state, worker=build.worker or "", error_code=code, error=message
            )
    except (ConflictError, NotFoundError):
        # The venue was deleted while the build ran, and the build with it, or another worker has taken it over.
        log.info("build %s is not ours any more", build.id)
