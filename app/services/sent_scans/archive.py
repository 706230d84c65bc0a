"""The archive of a scan, as the stream of a request or as an upload that is whole."""

from __future__ import annotations

import os
from pathlib import Path
from shutil import copyfile, copyfileobj
from typing import BinaryIO

from app.errors import ConflictError, InvalidScanError, PermissionDeniedError
from app.storage.uploads import UploadFolder


def whole_upload(uploads: UploadFolder, upload: str, venue: str | None) -> Path:
    """Return the file of an upload; `venue` is what it is used for, None where the caller may use all of them.

    Raises `NotFoundError` for an unknown upload, `PermissionDeniedError` for that of another venue, `ConflictError` for
    one that is not whole.
    """
    found = uploads.get(upload)
    if venue is not None and found.facts.venue_id not in (None, venue):
        raise PermissionDeniedError("This upload was begun for another venue.")
    if not found.is_whole:
        raise ConflictError(
            f"Of the upload {found.offset:,} of {found.facts.length:,} bytes have arrived; send the rest first."
        )
    return found.path


def archive_in(folder: Path, archive: BinaryIO | Path) -> Path:
    """Return a file in a folder with an archive's bytes; raises `InvalidScanError` for an empty one.

    A file is linked where that can be done, so that it stays readable when an upload is deleted meanwhile.
    """
    packed = folder / "archive"
    if isinstance(archive, Path):
        try:
            os.link(archive, packed)
        except OSError:
            copyfile(archive, packed)
    else:
        with packed.open("wb") as file:
            copyfileobj(archive, file)
    check_not_empty(packed)
    return packed


def check_not_empty(archive: Path) -> None:
    """Raise `InvalidScanError` for a file without any bytes."""
    if archive.stat().st_size == 0:
        raise InvalidScanError("The archive is empty; send a zip or tar of the scan.")
