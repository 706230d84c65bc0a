"""The maps that serve, opened once a process and kept while they are in use."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.errors import RoomfixError
from app.limits import limit
from app.lru import LruCache
from app.services.resources import Resources
from app.storage.maps import MapVersion, active_version, delete_map, list_keyframe_images
from app.storage.sweep import discard_blobs
from app.vision.index import GlobalIndex

log = logging.getLogger("roomfix.maps")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapCacheOptions:
    """How much of the maps stays open."""

    open_bytes: int = limit(
        4_000_000_000,
        "Sum of the file sizes of the maps that are kept open, those used last.",
        chosen="By hand: map files are memory-mapped, so most of it is page cache that the system can take back.",
    )


OPTIONS = MapCacheOptions()


@dataclass(frozen=True, slots=True)
class _Entry:
    """An open map and the size of its files."""

    opened: OpenMap
    file_bytes: int


class MapLibrary:
    """Gives the open map of a venue's active version; keeps the maps used last open, bounded by their size.

    A map that is being opened holds up only those who ask for it.
    """

    def __init__(self, resources: Resources) -> None:
        self._resources = resources
        self._open: LruCache[str, _Entry] = LruCache(OPTIONS.open_bytes, lambda entry: entry.file_bytes)

    def active(self, venue_id: str) -> tuple[OpenMap, MapVersion] | None:
        """Return the open map and the version that serve a venue, or None while it has no map.

        Raises `NotFoundError` for an unknown venue.
        """
        with self._resources.database.read() as connection:
            version = active_version(connection, venue_id)
        return None if version is None else (self.open(version), version)

    def warm(self, venue_ids: Iterable[str]) -> None:
        """Open the maps of venues, so that their first query doesn't have to."""
        for venue_id in venue_ids:
            try:
                self.active(venue_id)
            except RoomfixError as error:
                log.warning("the map of venue %s can't be opened: %s", venue_id, error)

    def open(self, version: MapVersion) -> OpenMap:
        """Return a version's map, opened when it is not open yet."""
        key = version.artifact_blob + version.index_blob
        return self._open.get_or_make(key, lambda: self._load(version)).opened

    def remove(self, venue_id: str, version: int) -> None:
        """Delete a map version with the blobs that nothing else needs.

        While a build runs its blobs stay, since that build may need the same; the sweep deletes them later. Raises
        `NotFoundError`, and `ConflictError` for the version that serves the venue.
        """
        resources = self._resources
        with resources.database.write() as connection:
            images = list_keyframe_images(connection, venue_id, version)
            found = delete_map(connection, venue_id, version)
        digests = [found.artifact_blob, found.index_blob]
        digests += [blob for image in images for blob in (image.color_blob, image.depth_blob)]
        discard_blobs(resources.database, resources.blobs, digests, written_by=found.build_id or "")

    def _load(self, version: MapVersion) -> _Entry:
        blobs = self._resources.blobs
        paths = blobs.local_path(version.artifact_blob), blobs.local_path(version.index_blob)
        artifact, index = MapArtifact.open(paths[0]), GlobalIndex.open(paths[1])
        # Reads every page of the index once, which the first query would wait for.
        index.search(index.descriptor(0), 1)
        opened = OpenMap.of(artifact, index, self._resources.models)
        return _Entry(opened, sum(path.stat().st_size for path in paths))
