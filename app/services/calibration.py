"""Calibration of an uploaded scan: unpacked into the scratch folder, measured, and gone again."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from shutil import copyfileobj
from typing import BinaryIO

from app.engine.mapping.calibrate import calibrate
from app.engine.mapping.calibration_curves import Calibration
from app.engine.mapping.options import BuildOptions
from app.engine.progress import NoProgress
from app.errors import InvalidScanError
from app.importers.archives.archive import extract_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.registry import open_scan
from app.services.resources import Resources
from app.storage.venues import get_venue

FOLDER_PREFIX = "calibrate-"


def calibrate_archive(
    resources: Resources, venue: str, options: BuildOptions, archive: BinaryIO
) -> Calibration:
    """Return the calibration of a scan's archive (zip or tar); nothing of it stays.

    Raises `NotFoundError` for an unknown venue, `InvalidScanError` for an archive that can't be calibrated with.
    """
    with resources.database.read() as connection:
        get_venue(connection, venue)
    limits = ArchiveLimits(max_total_bytes=resources.settings.max_unpacked_bytes)
    # What a killed server leaves here, the sweep of the scratch folder removes.
    with tempfile.TemporaryDirectory(dir=resources.scratch_dir, prefix=FOLDER_PREFIX) as folder:
        packed = Path(folder) / "archive"
        with packed.open("wb") as file:
            copyfileobj(archive, file)
        if packed.stat().st_size == 0:
            raise InvalidScanError("The archive is empty; send a zip or tar of the scan.")
        source = open_scan(
            extract_archive(packed, Path(folder) / "scan", limits),
            options.format,
            replace(options.scan, scratch=Path(folder)),
        )
        return calibrate(source, options, resources.models, resources.executor, NoProgress())
