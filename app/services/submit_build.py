"""A build request, checked and queued."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from shutil import copyfileobj
from typing import BinaryIO

from app.errors import InvalidInputError, InvalidScanError
from app.services.build_options import parse_build_options
from app.services.resources import Resources
from app.storage.builds import create_build
from app.storage.venues import get_venue


def submit_build(resources: Resources, venue: str, options: object, archive: BinaryIO) -> str:
    """Store a scan's archive, queue its build and return the build's id.

    Raises `NotFoundError` for an unknown venue, `InvalidInputError` for options that can't be meant,
    `InvalidScanError` for an empty archive. What is wrong inside the archive fails the build.
    """
    parse_build_options(options)
    # NaN and infinity pass Python's JSON but no database's.
    plain = json.loads(json.dumps(options, allow_nan=False))
    if not isinstance(plain, Mapping):
        raise InvalidInputError("options must be a JSON object.")
    with resources.database.read() as connection:
        get_venue(connection, venue)
    digest = _store(resources, archive)
    with resources.database.write() as connection:
        get_venue(connection, venue)
        return create_build(connection, venue, dict(plain), digest)


def _store(resources: Resources, archive: BinaryIO) -> str:
    with tempfile.NamedTemporaryFile(dir=resources.scratch_dir, prefix="upload-") as file:
        copyfileobj(archive, file)
        file.flush()
        path = Path(file.name)
        if path.stat().st_size == 0:
            raise InvalidScanError("The archive is empty; send a zip or tar of the scan.")
        return resources.blobs.put_file(path)
