"""Uploads that arrive in parts: a file each on this machine's disk, whose length says how much of it is here."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from app.errors import (
    BusyError,
    ConflictError,
    InvalidInputError,
    NotFoundError,
    StorageFullError,
    UploadLockedError,
    UploadTooLargeError,
)
from app.limits import limit
from app.storage.db import now

UPLOAD_ID = re.compile(r"[0-9a-f]{32}")
DATA_SUFFIX = ".part"
FACTS_SUFFIX = ".json"
STAGED_SUFFIX = ".new"


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadOptions:
    """How long uploads wait for their next part, and how many there may be."""

    keep_h: float = limit(
        24.0,
        "Hours after its last part for which an unfinished or unused upload is kept.",
        chosen="By hand: a connection that was lost in the evening is there again in the morning.",
    )
    max_open: int = limit(
        100,
        "Most uploads that are kept at a time.",
        chosen="By hand: far more than people scan at once; it bounds what empty uploads can take.",
    )
    spare_bytes: int = limit(
        500_000_000,
        "Free space of the disk that uploads leave alone.",
        chosen="By hand: database, logs and maps that are being built can still be written.",
    )


OPTIONS = UploadOptions()


@dataclass(frozen=True, slots=True)
class UploadFacts:
    """What is known of an upload from its beginning: its length, and the venue whose keys may go on with it, None for
    keys of all venues."""

    length: int
    venue_id: str | None


@dataclass(frozen=True, slots=True)
class Upload:
    """An upload as it is now: `offset` bytes of it are on the disk."""

    id: str
    facts: UploadFacts
    offset: int
    path: Path
    expires_at: datetime

    @property
    def is_whole(self) -> bool:
        """Whether all of it is here."""
        return self.offset == self.facts.length


class UploadFolder:
    """The uploads of one machine. What is on the disk is all there is: a restart changes nothing.

    `is_store_here` says that whole uploads are then copied to a store on the same disk.
    """

    def __init__(self, folder: Path, max_bytes: int, *, is_store_here: bool = True) -> None:
        self._folder, self.max_bytes = folder, max_bytes
        self._copies = 2 if is_store_here else 1

    def create(self, length: int, venue_id: str | None) -> Upload:
        """Begin an upload.

        Raises `UploadTooLargeError` for one over the limit, `StorageFullError` when it, and the rest of those that have
        begun, would not fit on the disk, `BusyError` when there are too many.
        """
        if length > self.max_bytes:
            raise UploadTooLargeError(
                f"The upload has {length:,} bytes; at most {self.max_bytes:,} are accepted."
            )
        self._folder.mkdir(parents=True, exist_ok=True)
        self.sweep()
        others = list(self._uploads())
        if len(others) >= OPTIONS.max_open:
            raise BusyError("There are too many unfinished uploads; finish or delete some.")
        expected = sum(self._copies * each.facts.length - each.offset for each in others)
        free = shutil.disk_usage(self._folder).free - expected - OPTIONS.spare_bytes
        if self._copies * length > free:
            raise StorageFullError(
                f"The upload needs {self._copies * length:,} bytes of the disk until it is stored, and "
                f"{max(free, 0):,} are free; nothing was stored."
            )
        upload_id = uuid.uuid4().hex
        self._data(upload_id).touch(exist_ok=False)
        # The facts come last: an upload without them is none.
        staged = self._facts(upload_id).with_suffix(STAGED_SUFFIX)
        staged.write_text(json.dumps(asdict(UploadFacts(length, venue_id))), encoding="utf-8")
        staged.replace(self._facts(upload_id))
        return self.get(upload_id)

    def get(self, upload_id: str) -> Upload:
        """Return an upload; raises `NotFoundError` for one that doesn't exist, or has expired."""
        try:
            facts = UploadFacts(**json.loads(self._facts(upload_id).read_text(encoding="utf-8")))
            state = self._data(upload_id).stat()
        except FileNotFoundError:
            raise _no_upload(upload_id) from None
        expires_at = datetime.fromtimestamp(state.st_mtime, UTC) + timedelta(hours=OPTIONS.keep_h)
        return Upload(upload_id, facts, state.st_size, self._data(upload_id), expires_at)

    @contextmanager
    def appending(self, upload_id: str, offset: int) -> Iterator[UploadPart]:
        """Give what writes the next part of an upload, which begins at `offset`; what was written is on the disk when
        this ends, with or without an error.

        Raises `UploadLockedError` while another part is being written, `ConflictError` for another offset than that of
        the upload.
        """
        with self._locked(upload_id) as file:
            upload = self.get(upload_id)
            if upload.offset != offset:
                raise ConflictError(f"The upload goes on at {upload.offset}, not at {offset}.")
            try:
                yield UploadPart(file, upload.facts.length - offset)
            finally:
                file.flush()
                os.fsync(file.fileno())

    def delete(self, upload_id: str) -> None:
        """Remove an upload; raises `NotFoundError`, or `UploadLockedError` while a part of it is being written."""
        with self._locked(upload_id):
            self._remove(upload_id)

    def sweep(self) -> None:
        """Remove uploads that have expired, and what is left of such whose beginning was interrupted."""
        limit_s = (now() - timedelta(hours=OPTIONS.keep_h)).timestamp()
        for path in self._folder.glob(f"*{DATA_SUFFIX}"):
            with suppress(FileNotFoundError, NotFoundError, UploadLockedError):
                if path.stat().st_mtime < limit_s:
                    with self._locked(path.stem):
                        self._remove(path.stem)

    @contextmanager
    def _locked(self, upload_id: str) -> Iterator[BinaryIO]:
        try:
            # Not made by this: a file that isn't there any more stays away.
            file = os.fdopen(os.open(self._data(upload_id), os.O_WRONLY | os.O_APPEND), "ab")
        except FileNotFoundError:
            raise _no_upload(upload_id) from None
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UploadLockedError("A part of this upload is being written; ask again.") from None
            yield file

    def _remove(self, upload_id: str) -> None:
        self._facts(upload_id).unlink(missing_ok=True)
        self._data(upload_id).with_suffix(STAGED_SUFFIX).unlink(missing_ok=True)
        self._data(upload_id).unlink(missing_ok=True)

    def _uploads(self) -> Iterator[Upload]:
        for path in self._folder.glob(f"*{FACTS_SUFFIX}"):
            with suppress(NotFoundError):
                yield self.get(path.stem)

    def _data(self, upload_id: str) -> Path:
        if not UPLOAD_ID.fullmatch(upload_id):
            raise _no_upload(upload_id)
        return self._folder / f"{upload_id}{DATA_SUFFIX}"

    def _facts(self, upload_id: str) -> Path:
        if not UPLOAD_ID.fullmatch(upload_id):
            raise _no_upload(upload_id)
        return self._folder / f"{upload_id}{FACTS_SUFFIX}"


def _no_upload(upload_id: str) -> NotFoundError:
    return NotFoundError(f"There is no upload {upload_id!r}; it may have expired.")


class UploadPart:
    """Writes a part of an upload, piece by piece."""

    def __init__(self, file: BinaryIO, room: int) -> None:
        self._file, self._room = file, room

    def write(self, piece: bytes) -> None:
        """Write a piece; raises `InvalidInputError` when it goes beyond the end of the upload."""
        if len(piece) > self._room:
            raise InvalidInputError("The part goes on beyond the upload's stated length.")
        self._file.write(piece)
        self._room -= len(piece)
