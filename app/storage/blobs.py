"""Content-addressed blobs: a directory by default, any store that obstore knows by URL."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import BaseError
from obstore.store import LocalStore, ObjectStore, from_url

from app.errors import NotFoundError, StorageError, StorageFullError
from app.limits import limit
from app.storage.blob_cache import BlobCache
from app.storage.db import now

log = logging.getLogger("roomfix.storage")
PREFIX = "sha256"
# obstore writes a local file under a name with this mark, then renames it; a killed process leaves it behind.
STAGING_MARK = "#"


@dataclass(frozen=True, slots=True, kw_only=True)
class BlobOptions:
    """How blobs are read."""

    read_chunk_bytes: int = limit(
        1 << 20,
        "Bytes of a file that are read and hashed at a time.",
        chosen="By hand: few calls, and little memory.",
    )
    remote_retries: int = limit(
        4,
        "Times that a call of a remote store is tried again.",
        chosen="By hand: a store that restarts or throttles answers within them.",
    )
    remote_retry_s: float = limit(
        20.0,
        "Time after which such a call is not tried again.",
        chosen="By hand: a client that waits for the answer has not given up yet.",
    )


OPTIONS = BlobOptions()


class BlobStore:
    """Stores bytes by their SHA-256. A blob is stored whole or not at all, and never changes."""

    def __init__(self, store: ObjectStore, cache: BlobCache, root: Path | None = None) -> None:
        self._store = store
        self._root = root
        self._cache = cache

    @staticmethod
    def open(url: str | None, data_dir: Path, cache_dir: Path, cache_bytes: int = 0) -> BlobStore:
        """Open the store of a URL (`s3://bucket/prefix`, ...), or the folder `blobs` in `data_dir`.

        Up to `cache_bytes` of the blobs of a remote store are kept in `cache_dir`. The store takes its credentials and
        address from the places that are usual for it, such as `AWS_ACCESS_KEY_ID`.
        """
        cache = BlobCache(cache_dir, cache_bytes)
        if url is not None:
            retry: Any = {
                "max_retries": OPTIONS.remote_retries,
                "retry_timeout": timedelta(seconds=OPTIONS.remote_retry_s),
            }
            return BlobStore(from_url(url, retry_config=retry), cache)
        root = (data_dir / "blobs").resolve()
        root.mkdir(parents=True, exist_ok=True)
        return BlobStore(LocalStore(str(root)), cache, root)

    def put(self, data: bytes) -> str:
        """Store bytes and return their SHA-256."""
        digest = hashlib.sha256(data).hexdigest()
        # Written even when it exists: that renews its age, and the sweep deletes only old blobs.
        with _failures_translated():
            obstore.put(self._store, _path(digest), data)
        return digest

    def put_file(self, path: Path) -> str:
        """Store a file's contents and return their SHA-256."""
        hasher = hashlib.sha256()
        with path.open("rb") as file:
            while chunk := file.read(OPTIONS.read_chunk_bytes):
                hasher.update(chunk)
        digest = hasher.hexdigest()
        with _failures_translated():
            obstore.put(self._store, _path(digest), path)
        return digest

    def get(self, digest: str) -> bytes:
        """Return a blob's bytes; raises `NotFoundError`."""
        with _reading(digest):
            return bytes(obstore.get(self._store, _path(digest)).bytes())

    def stream(self, digest: str) -> Iterator[bytes]:
        """Yield a blob's bytes in pieces, past the cache; raises `NotFoundError`."""
        with _reading(digest):
            for piece in obstore.get(self._store, _path(digest)).stream():
                yield bytes(piece)

    def local_path(self, digest: str) -> Path:
        """Return a file with the blob's contents, for memory-mapping; a remote blob is fetched into the cache."""
        if self._root is not None:
            path = self._root / _path(digest)
            if not path.is_file():
                raise NotFoundError(f"Blob {digest} is missing from the store.")
            return path
        return self._cache.find(digest) or self._cache.add(digest, self.stream(digest))

    def forget(self, *digests: str) -> bool:
        """Remove the local copies of blobs of a remote store; return whether they can be fetched again."""
        if self._root is not None:
            return False
        for digest in digests:
            self._cache.forget(digest)
        return True

    def contains(self, digest: str) -> bool:
        """Return whether the store has the blob."""
        return self.size(digest) is not None

    def size(self, digest: str) -> int | None:
        """Return the size of a blob in bytes, None when the store doesn't have it."""
        try:
            with _reading(digest):
                return int(obstore.head(self._store, _path(digest))["size"])
        except NotFoundError:
            return None

    def delete(self, digests: Iterable[str]) -> None:
        """Delete blobs; one that doesn't exist is no error."""
        for digest in digests:
            with suppress(NotFoundError), _reading(digest):
                obstore.delete(self._store, _path(digest))

    def older_than(self, age: timedelta) -> set[str]:
        """Return the SHA-256 of every blob that was stored longer ago than `age`."""
        limit = now() - age
        return {
            item["path"].rsplit("/", 1)[-1]
            for page in obstore.list(self._store, PREFIX)
            for item in page
            if item["last_modified"] <= limit
        }

    def sweep_staging(self, age: timedelta) -> int:
        """Delete the files of writes that were interrupted longer ago than `age`; return their number."""
        if self._root is None:
            return 0
        limit = now() - age
        count = 0
        for path in self._root.rglob(f"*{STAGING_MARK}*"):
            if path.is_file() and path.stat().st_mtime <= limit.timestamp():
                path.unlink(missing_ok=True)
                count += 1
        return count

    def digests(self) -> set[str]:
        """Return the SHA-256 of every blob in the store."""
        return {
            item["path"].rsplit("/", 1)[-1] for page in obstore.list(self._store, PREFIX) for item in page
        }

    def check_writable(self) -> None:
        """Raise `OSError` if the folder of the store can't be written; a remote store is only asked for a listing.

        Raises `StorageError` for a remote store that doesn't answer.
        """
        if self._root is not None:
            if not os.access(self._root, os.W_OK):
                raise PermissionError(f"{self._root} can't be written.")
            return
        with _reading(PREFIX):
            next(iter(obstore.list(self._store, PREFIX)), None)


@contextmanager
def _failures_translated() -> Iterator[None]:
    """Turn the error of a store that can't be written into `StorageError`."""
    try:
        yield
    except BaseError as error:
        if f"(os error {errno.ENOSPC})" in str(error):
            raise StorageFullError("No space is left for blobs; free some, nothing was stored.") from error
        log.exception("a blob could not be stored")
        raise StorageError("Blobs can't be stored: the disk or the object store refuses them.") from error


@contextmanager
def _reading(digest: str) -> Iterator[None]:
    """Turn the errors of a store that lacks a blob, or can't be asked, into `NotFoundError` and `StorageError`."""
    try:
        yield
    except FileNotFoundError:
        raise NotFoundError(f"Blob {digest} is missing from the store.") from None
    except BaseError as error:
        log.exception("the store of blobs doesn't answer")
        raise StorageError("Blobs can't be read: the disk or the object store doesn't answer.") from error


def _path(digest: str) -> str:
    return f"{PREFIX}/{digest[:2]}/{digest}"
