"""The files of a map version, verified when they are opened."""

from __future__ import annotations

import hashlib
from pathlib import Path
from threading import Lock

import numpy as np

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.checked_rows import checksum
from app.errors import MapDamagedError, NotFoundError
from app.storage.blobs import OPTIONS, BlobStore
from app.storage.maps import MapVersion
from app.vision.index import GlobalIndex


class MapFiles:
    """Opens the files of map versions. Safe to share between threads."""

    def __init__(self, blobs: BlobStore) -> None:
        self._blobs = blobs
        self._lock = Lock()
        self._verified: set[str] = set()

    def open(self, version: MapVersion) -> tuple[MapArtifact, GlobalIndex]:
        """Return a version's artefact and index; raises `MapDamagedError` for files that are missing or are not what
        was stored.

        The copy of a remote blob that was damaged in the cache is fetched again.
        """
        try:
            return self._open(version)
        except MapDamagedError:
            if not self._blobs.forget(version.artifact_blob, version.index_blob):
                raise
            return self._open(version)

    def file_bytes(self, version: MapVersion) -> int:
        """Return the size of a version's files."""
        return sum(
            self._path(digest).stat().st_size for digest in (version.artifact_blob, version.index_blob)
        )

    def _open(self, version: MapVersion) -> tuple[MapArtifact, GlobalIndex]:
        artifact_path, index_path = self._path(version.artifact_blob), self._path(version.index_blob)
        artifact = MapArtifact.open(artifact_path)
        if artifact.checker is None:
            self._verify_whole(artifact_path, version.artifact_blob)
        if artifact.index_checksum is None:
            self._verify_whole(index_path, version.index_blob)
        elif file_checksum(index_path) != artifact.index_checksum:
            raise MapDamagedError(f"The index file {index_path.name} is damaged: it has another checksum.")
        return artifact, GlobalIndex.open(index_path)

    def _path(self, digest: str) -> Path:
        try:
            return self._blobs.local_path(digest)
        except NotFoundError as error:
            raise MapDamagedError(str(error)) from None

    def _verify_whole(self, path: Path, digest: str) -> None:
        """Compare a file without checksums with the name of its blob, once in the life of this object."""
        if digest in self._verified:
            return
        if sha256_of(path) != digest:
            raise MapDamagedError(
                f"The map file {path.name} is damaged: its contents are not what was stored."
            )
        with self._lock:
            self._verified.add(digest)


def file_checksum(path: Path) -> int:
    """Return the 64-bit XXH3 checksum of a file."""
    if path.stat().st_size == 0:
        return checksum(b"")
    return checksum(np.memmap(path, dtype=np.uint8, mode="r"))


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    hasher = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(OPTIONS.read_chunk_bytes):
            hasher.update(chunk)
    return hasher.hexdigest()
