"""Inspection of an uploaded scan: unpacked into the scratch folder, looked at, and gone again."""

from __future__ import annotations

import tempfile
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from app.engine.mapping.inspection.inspect import inspect_scan
from app.engine.mapping.inspection.unposed import inspect_unposed
from app.engine.mapping.options import BuildOptions
from app.engine.progress import NoProgress, Progress
from app.importers.archives.archive import names_in_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.recognition import recognised
from app.importers.registry import find_scan, open_scan
from app.importers.unpack_scan import unpack_scan
from app.services.examine_scan import unposed_scan
from app.services.resources import Resources
from app.services.sent_scans.archive import archive_in

FOLDER_PREFIX = "inspect-"


def inspect_archive(resources: Resources, options: BuildOptions, archive: BinaryIO | Path) -> dict[str, Any]:
    """Return the inspection of a scan's archive or recording for JSON; nothing of it stays.

    Pictures without poses are chosen as by a build. Raises `InvalidScanError` for what no map can be made of; the
    sentence is that of a build.
    """
    with tempfile.TemporaryDirectory(dir=resources.scratch_dir, prefix=FOLDER_PREFIX) as folder:
        packed = archive_in(Path(folder), archive)
        limits = ArchiveLimits(max_total_bytes=resources.settings.max_unpacked_bytes)
        return inspect_sent(packed, options, resources.executor, NoProgress(), Path(folder), limits)


def inspect_sent(
    sent: Path,
    options: BuildOptions,
    executor: Executor,
    progress: Progress,
    scratch: Path,
    limits: ArchiveLimits | None = None,
) -> dict[str, Any]:
    """Return the inspection of a folder, an archive or a recording; it is unpacked below `scratch`."""
    names = _names(sent, limits)
    root = sent if sent.is_dir() else unpack_scan(sent, scratch / "scan", limits)
    given = replace(options, scan=replace(options.scan, scratch=scratch))
    return {
        "recognised": [item.as_dict() for item in recognised(names)],
        **_inspected(root, given, executor, progress),
    }


def _inspected(root: Path, given: BuildOptions, executor: Executor, progress: Progress) -> dict[str, Any]:
    unposed = unposed_scan(root, given, given.scan)
    if unposed is not None:
        return inspect_unposed(unposed, given, progress).as_dict()
    _, name = find_scan(root, given.format)
    return inspect_scan(open_scan(root, given.format, given.scan), name, given, executor, progress).as_dict()


def _names(sent: Path, limits: ArchiveLimits | None) -> list[str]:
    if sent.is_dir():
        return [path.relative_to(sent).as_posix() for path in sent.rglob("*") if path.is_file()]
    return names_in_archive(sent, limits)
