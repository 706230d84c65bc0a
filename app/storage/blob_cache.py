"""Local copies of the blobs of a remote store, for memory-mapping: the ones used last, up to a number of bytes."""

from __future__ import annotations

import os
import re
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from app.limits import limit

DIGEST = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BlobCacheOptions:
    """Which local copies are never removed, and which always."""

    min_unused_s: float = limit(
        60.0,
        "A copy that was used less long ago is kept even over the limit of bytes.",
        chosen="By hand: whoever has asked for its path opens it long before; once open it may be removed.",
    )
    abandoned_s: float = limit(
        3600.0,
        "Age from which a partial copy belongs to a process that was killed.",
        chosen="By hand: longer than it takes to fetch the largest map.",
    )


OPTIONS = BlobCacheOptions()


class BlobCache:
    """A folder of copies, shared by the processes of a machine. Safe to share between threads."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes

    def find(self, digest: str) -> Path | None:
        """Return the copy of a blob and note that it is used, or None."""
        path = self._folder / digest
        try:
            os.utime(path)
        except FileNotFoundError:
            return None
        return path

    def add(self, digest: str, pieces: Iterator[bytes]) -> Path:
        """Write a copy, whole or not at all, and remove those used longest ago when there are too many bytes."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / digest
        partial = path.with_name(f"{digest}.{uuid.uuid4().hex}")
        try:
            with partial.open("wb") as file:
                for piece in pieces:
                    file.write(piece)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
        self._make_room()
        return path

    def forget(self, digest: str) -> None:
        """Remove the copy of a blob."""
        (self._folder / digest).unlink(missing_ok=True)

    def _make_room(self) -> None:
        """Remove copies until the rest has at most the limit of bytes; open ones stay readable to whoever has them."""
        now_s, used_bytes = time.time(), 0
        for path, status in sorted(self._entries(), key=lambda entry: -entry[1].st_mtime):
            unused_s = now_s - status.st_mtime
            if DIGEST.fullmatch(path.name) is None:
                if unused_s > OPTIONS.abandoned_s:
                    path.unlink(missing_ok=True)
                continue
            used_bytes += status.st_size
            if used_bytes > self._max_bytes and unused_s >= OPTIONS.min_unused_s:
                path.unlink(missing_ok=True)

    def _entries(self) -> Iterator[tuple[Path, os.stat_result]]:
        for path in self._folder.iterdir():
            # Another process may remove it meanwhile.
            with suppress(FileNotFoundError):
                yield path, path.stat()
