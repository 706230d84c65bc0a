"""The folder of the scan in an archive that was sent, however many folders lie around it."""

from __future__ import annotations

from pathlib import Path

from app.importers.archives.archive import Progress, extract_archive
from app.importers.archives.archive_readers import ArchiveLimits
from app.importers.registry import format_at


def unpack_scan(
    archive: Path,
    destination: Path,
    limits: ArchiveLimits | None = None,
    progress: Progress | None = None,
) -> Path:
    """Unpack a scan's archive and return the scan's folder; the arguments and errors are those of `extract_archive`.

    Folders that hold one folder and nothing else are passed. The exception is a folder that is itself part of a format,
    as `keyframes` of Polycam or `sensors` of kapture is: then the scan's folder is the one that it lies in.
    """
    innermost = extract_archive(archive, destination, limits, progress)
    folder = destination
    for name in innermost.relative_to(destination).parts:
        found = format_at(folder)
        # A folder of sequences and its only sequence are both a scan of 7-Scenes.
        if found is not None and format_at(folder / name) != found:
            return folder
        folder /= name
    return folder
