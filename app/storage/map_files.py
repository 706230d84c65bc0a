"""The files of a map version, verified when they are opened."""

from __future__ import annotations

import hashlib
from pathlib import Path
from threading import Lock

import numpy as np

from app.engine.maps.artifact import FileChecksums, MapArtifact
from app.engine.maps.checked_rows import OPTIONS as CHECKSUMS
from app.engine.maps.checked_rows import BlockChecker, checksum, checksums_of_blocks
from app.engine.maps.surroundings import with_places
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
        if artifact.index_checksums is None:
            self._verify_whole(index_path, version.index_blob)
        return artifact, open_index(artifact, index_path)

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


def write_map(artifact: MapArtifact, index: GlobalIndex, artifact_path: Path, index_path: Path) -> None:
    """Write the two files of a map, with all that opening it would compute."""
    index.write(index_path)
    data = np.memmap(index_path, dtype=np.uint8, mode="r")
    # A small index is read whole by each search.
    is_large = not index.is_exact and len(data) > CHECKSUMS.eager_bytes
    blocks = checksums_of_blocks(data, CHECKSUMS.index_block_bytes) if is_large else None
    checksums = FileChecksums(checksum(data), blocks, CHECKSUMS.index_block_bytes)
    with_places(artifact).write(artifact_path, checksums)


def open_index(artifact: MapArtifact, path: Path) -> GlobalIndex:
    """Return the index of a map; raises `MapDamagedError` when its file has another checksum than the map states.

    The whole descriptors of a large one are verified when they are used.
    """
    checksums = artifact.index_checksums
    if checksums is None:
        return GlobalIndex.open(path)
    # FAISS refuses an empty file.
    data = np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.zeros(0, np.uint8)
    damaged = MapDamagedError(f"The index file {path.name} is damaged: it has another checksum.")
    if checksums.blocks is None:
        if checksum(data) != checksums.whole:
            raise damaged
        return GlobalIndex.open(path)
    if checksums.block_bytes <= 0 or -(-len(data) // checksums.block_bytes) != len(checksums.blocks):
        raise damaged
    checker = BlockChecker(data, checksums.blocks, checksums.block_bytes, path.name)
    return GlobalIndex.open_large(path, checker, artifact.keyframe_count, artifact.metadata.descriptor_size)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    hasher = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(OPTIONS.read_chunk_bytes):
            hasher.update(chunk)
    return hasher.hexdigest()
