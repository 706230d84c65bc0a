"""A build request, checked and queued, or taken back."""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import copyfileobj
from typing import Any, BinaryIO

from app.build_kinds import Kind
from app.engine.mapping.options import BuildOptions, parse_build_options
from app.errors import (
    ConflictError,
    InvalidInputError,
    InvalidScanError,
    NotFoundError,
    UploadLockedError,
)
from app.importers.archives.archive import names_in_archive
from app.importers.archives.lone_recording import suffix_of_recording
from app.importers.recognition import recognised
from app.services.resources import Resources
from app.services.sent_scans.archive import check_not_empty, whole_upload
from app.storage.builds import Build, cancel_build, create_build, find_submission
from app.storage.db import hold_blobs
from app.storage.sweep import discard_blobs
from app.storage.uploads import UploadFolder
from app.storage.venues import get_venue

UPLOAD_PREFIX = "upload-"
# The formats whose poses are estimated from the pictures; all others are scans.
KIND_OF_FORMAT: Mapping[str, Kind] = {"recording": "recording", "video": "pictures", "images": "pictures"}


def submit_build(
    resources: Resources,
    venue: str,
    options: object,
    archive: BinaryIO | Path,
    idempotency_key: str | None = None,
    priority: int = 0,
) -> str:
    """Store a scan's archive, a stream or a file that stays as it is, queue its build and return the build's id.

    Raises `NotFoundError` for an unknown venue, `InvalidInputError` for options that can't be meant,
    `InvalidScanError` for an empty archive. A submission with the `idempotency_key` of an earlier one of the venue is
    that build; `ConflictError` if scan or options differ. What is wrong inside the archive fails the build.
    """
    parsed = parse_build_options(options)
    if parsed.blur_faces:
        # Refused now where it can't be done, not at the end of the build.
        _ = resources.models.faces
    plain = _plain(options)
    with resources.database.read() as connection:
        get_venue(connection, venue)
    with _as_file(resources.scratch_dir, archive) as path:
        kind = kind_of(parsed, path)
        digest = resources.blobs.put_file(path)
        with resources.database.write() as connection:
            get_venue(connection, venue)
            hold_blobs(connection)
            earlier = find_submission(connection, venue, idempotency_key)
            if earlier is not None:
                _check_same(earlier, plain, digest)
                return earlier.id
            # A build of the same archive may have ended, and discarded it, since it was stored.
            if not resources.blobs.contains(digest):
                resources.blobs.put_file(path)
            return create_build(
                connection, venue, plain, digest, idempotency_key, kind=kind, priority=priority
            )


def submit_upload(
    resources: Resources,
    uploads: UploadFolder,
    venue: str,
    options: object,
    upload: str,
    idempotency_key: str | None = None,
    priority: int = 0,
) -> str:
    """Queue a build of an upload that is whole, remove the upload and return the build's id.

    Raises as `submit_build` does, `NotFoundError` for an unknown upload, `PermissionDeniedError` for that of another
    venue, `ConflictError` for one that is not whole. The upload of an earlier submission with the `idempotency_key` is
    gone, and its build is returned.
    """
    try:
        path = whole_upload(uploads, upload, venue)
    except NotFoundError:
        with resources.database.read() as connection:
            earlier = find_submission(connection, venue, idempotency_key)
        if earlier is None or earlier.options != _plain(options):
            raise
        return earlier.id
    build_id = submit_build(resources, venue, options, path, idempotency_key, priority)
    with suppress(NotFoundError, UploadLockedError):
        uploads.delete(upload)
    return build_id


def kind_of(options: BuildOptions, archive: Path) -> Kind:
    """Return the kind of a build by its options and, where they leave it open, by the names of the archive's files.

    Only a zip and a single file are looked into: a packed tar would have to be read whole. What can't be told, or can't
    be read, counts as a scan.
    """
    if options.scan.estimate_poses:
        return "pictures"
    if options.format != "auto":
        return KIND_OF_FORMAT.get(options.format, "scan")
    if suffix_of_recording(archive) is None and not zipfile.is_zipfile(archive):
        return "scan"
    try:
        found = recognised(names_in_archive(archive))
    except InvalidScanError:
        return "scan"
    return KIND_OF_FORMAT.get(found[0].format, "scan") if found else "scan"


def withdraw_build(resources: Resources, build_id: str) -> Build:
    """Cancel a build; raises `NotFoundError`, or `ConflictError` when it has ended."""
    with resources.database.write() as connection:
        build = cancel_build(connection, build_id)
    if build.ended:
        discard_blobs(resources.database, resources.blobs, [build.archive_blob])
    return build


def _check_same(earlier: Build, options: dict[str, Any], archive_blob: str) -> None:
    if earlier.options != options or earlier.archive_blob != archive_blob:
        raise ConflictError(
            f"Build {earlier.id} was submitted with this Idempotency-Key, and with another scan or other options."
        )


@contextmanager
def _as_file(folder: Path, archive: BinaryIO | Path) -> Iterator[Path]:
    """Give a file with an archive's bytes: its own, or one that they are copied to."""
    if isinstance(archive, Path):
        check_not_empty(archive)
        yield archive
        return
    with tempfile.NamedTemporaryFile(dir=folder, prefix=UPLOAD_PREFIX) as file:
        copyfileobj(archive, file)
        file.flush()
        path = Path(file.name)
        check_not_empty(path)
        yield path


def _plain(options: object) -> dict[str, Any]:
    """Return the options as the database can hold them."""
    try:
        plain = json.loads(json.dumps(options, allow_nan=False))
    except ValueError:
        raise InvalidInputError("options holds a number that is not finite.") from None
    if not isinstance(plain, dict):
        raise InvalidInputError("options must be a JSON object.")
    return plain
