"""Calibration of an uploaded scan: in a process of its own, since nobody vouches for what the archive holds.

A decoder that crashes, or takes much memory, ends that process and not the server.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from app import errors
from app.engine.mapping.calibrate import calibrate
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.engine.progress import NoProgress
from app.errors import InvalidScanError, RoomfixError
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.registry import open_scan
from app.importers.unpack_scan import unpack_scan
from app.services.resources import Resources, cap_threads, open_models
from app.services.sent_scans.archive import archive_in
from app.settings import Settings
from app.storage.venues import get_venue

FOLDER_PREFIX = "calibrate-"
COMMAND = (sys.executable, "-m", "app.services.calibration")
CRASHED = (
    "Reading the scan ended its process, as damaged images and depth files can; send it again, or build from a part "
    "of it to find the file."
)


def calibrate_archive(
    resources: Resources, venue: str, options: object, archive: BinaryIO | Path
) -> dict[str, Any]:
    """Return the calibration of a scan's archive (zip or tar) as JSON; nothing of it stays.

    Raises `NotFoundError` for an unknown venue, `InvalidScanError` for an archive that can't be calibrated with.
    """
    parse_build_options(options)
    with resources.database.read() as connection:
        get_venue(connection, venue)
    # What a killed server leaves here, the sweep of the scratch folder removes.
    with tempfile.TemporaryDirectory(dir=resources.scratch_dir, prefix=FOLDER_PREFIX) as folder:
        packed = archive_in(Path(folder).resolve(), archive)
        settings = resources.settings.model_dump(mode="json", exclude={"admin_key"})
        order = {"settings": settings, "options": options, "archive": str(packed)}
        ended = subprocess.run(  # noqa: S603 - our own module
            COMMAND, input=json.dumps(order).encode(), stdout=subprocess.PIPE, check=False
        )
    return _result_of(ended)


def _result_of(ended: subprocess.CompletedProcess[bytes]) -> dict[str, Any]:
    if ended.returncode != 0:
        raise InvalidScanError(CRASHED)
    answer: dict[str, Any] = json.loads(ended.stdout)
    if "error" in answer:
        raise getattr(errors, answer["error"])(answer["message"])
    return dict(answer["calibration"])


def main() -> None:
    """Calibrate by the order on standard input; the result, or the error, goes to standard output."""
    order = json.load(sys.stdin)
    cap_threads()
    settings = Settings(_env_file=None, **order["settings"])
    try:
        options = parse_build_options(order["options"])
        answer: dict[str, Any] = {"calibration": _calibrate(settings, options, Path(order["archive"]))}
    except RoomfixError as error:
        answer = {"error": type(error).__name__, "message": str(error)}
    json.dump(answer, sys.stdout)


def _calibrate(settings: Settings, options: BuildOptions, archive: Path) -> dict[str, Any]:
    limits = ArchiveLimits(max_total_bytes=settings.max_unpacked_bytes)
    root = unpack_scan(archive, archive.with_name("scan"), limits)
    source = open_scan(root, options.format, replace(options.scan, scratch=archive.parent))
    with ThreadPoolExecutor(settings.workers) as executor:
        found = calibrate(source, options, open_models(settings), executor, NoProgress())
    return found.as_dict()


if __name__ == "__main__":
    main()
