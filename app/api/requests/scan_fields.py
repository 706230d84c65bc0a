"""The scan of a call: a file of its form, or the id of an upload."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, BinaryIO

from fastapi import File, Form, UploadFile
from fastapi.exceptions import RequestValidationError

from app.services.sent_scans.archive import whole_upload
from app.storage.uploads import UploadFolder

ArchiveField = Annotated[UploadFile | None, File(description="The scan: zip, tar or recording")]
UploadField = Annotated[
    str | None, Form(description="In place of archive: the id of an upload that is whole")
]


def check_one_scan(archive: UploadFile | None, upload: str | None) -> None:
    """Raise `RequestValidationError` unless a call has either an archive or the id of an upload."""
    if (archive is None) == (upload is None):
        message = "Send the scan as archive, or the id of its upload as upload"
        raise RequestValidationError([{"type": "missing", "loc": ("body", "archive"), "msg": message}])


def archive_of(
    archive: UploadFile | None, upload: str | None, uploads: UploadFolder, venue: str | None
) -> BinaryIO | Path:
    """Return what a call has sent as its scan; raises as `check_one_scan` and `whole_upload`."""
    check_one_scan(archive, upload)
    if archive is not None:
        return archive.file
    return whole_upload(uploads, upload or "", venue)
