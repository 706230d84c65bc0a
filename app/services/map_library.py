"""The maps that serve, opened once a process and kept while they are in use."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Iterable
from threading import Lock

from app.engine.maps.artifact import MapArtifact
from app.engine.maps.open_map import OpenMap
from app.errors import RoomfixError
from app.services.resources import Resources
from app.storage.maps import MapVersion, active_version
from app.vision.index import GlobalIndex

log = logging.getLogger("roomfix.maps")
CAPACITY = 16


class MapLibrary:
    """Gives the open map of a venue's active version; holds the last 16 maps used, memory-mapped."""

    def __init__(self, resources: Resources) -> None:
        self._resources = resources
        self._lock = Lock()
        self._open: OrderedDict[str, OpenMap] = OrderedDict()

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
        with self._lock:
            key = version.artifact_blob + version.index_blob
            opened = self._open.get(key)
            if opened is None:
                opened = self._load(version)
                self._open[key] = opened
            self._open.move_to_end(key)
            while len(self._open) > CAPACITY:
                self._open.popitem(last=False)
            return opened

    def _load(self, version: MapVersion) -> OpenMap:
        blobs = self._resources.blobs
        artifact = MapArtifact.open(blobs.local_path(version.artifact_blob))
        index = GlobalIndex.open(blobs.local_path(version.index_blob))
        # Reads every page of the index once, which the first query would wait for.
        index.search(index.descriptor(0), 1)
        return OpenMap.of(artifact, index, self._resources.models)
