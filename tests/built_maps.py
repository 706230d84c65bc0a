"""Maps that many tests need and none of them is about: a scan is built once in a run of the tests, then copied.

The build is the real one, in this process instead of a worker's. All processes of the run share the folder that the
environment variable `FOLDER_VARIABLE` names; `tests.fixtures` makes and removes it.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import Connection, insert, select

from app.jobs.handlers import handle_build
from app.services.map_library import MapLibrary
from app.services.resources import Resources
from app.services.submit_build import submit_build
from app.settings import Settings
from app.storage.builds import claim_build, get_build
from app.storage.db import Database
from app.storage.tables import builds, keyframe_images, left_out_frames, map_versions
from app.storage.venues import create_venue, get_venue, set_active_map

FOLDER_VARIABLE = "TESTS_BUILT_MAPS"
DONE = "done"
VENUE = "v"
# A scan's archive and the options that it is built with.
Scan = tuple[bytes, Mapping[str, object]]


def publish(data_dir: Path, venue: str, scans: Sequence[Scan]) -> str:
    """Give a venue without a map the one that these scans, in this order, are built to; return its last build.

    The server of the data folder may run: to it this is what a worker publishes.
    """
    folder = _built(scans)
    shutil.copytree(folder / "blobs", data_dir / "blobs", dirs_exist_ok=True)
    source, target = _database(folder), _database(data_dir)
    try:
        with source.read() as there, target.write() as here:
            return _copy_rows(there, here, venue)
    finally:
        source.close()
        target.close()


def _copy_rows(there: Connection, here: Connection, venue: str) -> str:
    get_venue(here, venue)
    # Two venues of a server may have copies of the same map.
    ids = {row.id: uuid.uuid4().hex for row in there.execute(select(builds).order_by(builds.c.map_version))}
    for table in (builds, map_versions, keyframe_images, left_out_frames):
        rows = [{**row._mapping, "venue_id": venue} for row in there.execute(select(table))]
        for row in rows:
            for name in ("id", "build_id"):
                if name in row:
                    row[name] = ids[row[name]]
        if rows:
            here.execute(insert(table), rows)
    active = get_venue(there, VENUE).active_map_version
    assert active is not None
    set_active_map(here, venue, active)
    return list(ids.values())[-1]


def _built(scans: Sequence[Scan]) -> Path:
    """Return the data folder in which a venue's scans were built, by this process or another one."""
    key = hashlib.sha256()
    for archive, options in scans:
        key.update(hashlib.sha256(archive).digest())
        key.update(json.dumps(options, sort_keys=True).encode())
    folder = Path(os.environ[FOLDER_VARIABLE]) / key.hexdigest()[:32]
    with _lock_of(folder):
        if not (folder / DONE).exists():
            shutil.rmtree(folder, ignore_errors=True)
            _build(folder, scans)
            (folder / DONE).touch()
    return folder


@contextmanager
def _lock_of(folder: Path) -> Iterator[None]:
    with folder.with_suffix(".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _build(folder: Path, scans: Sequence[Scan]) -> None:
    resources = Resources.open(Settings(_env_file=None, data_dir=folder, open=True))
    library = MapLibrary(resources)
    try:
        with resources.database.write() as connection:
            create_venue(connection, VENUE, VENUE)
        for archive, options in scans:
            submit_build(resources, VENUE, dict(options), io.BytesIO(archive))
            with resources.database.write() as connection:
                build = claim_build(connection, "tests")
            assert build is not None
            handle_build(build, resources, library)
            with resources.database.read() as connection:
                ended = get_build(connection, build.id)
            assert ended.state == "succeeded", ended.error
    finally:
        resources.close()


def _database(folder: Path) -> Database:
    return Database(f"sqlite:///{folder / 'roomfix.db'}")
