"""The maps that serve, opened once a process and kept while they are in use."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Iterable
from threading import Lock

from app.engine.maps.artifact import MapArtifact
from app.engine.query.localizer import Localizer
from app.errors import RoomfixError
from app.services.resources import Resources
from app.storage.maps import MapVersion, get_map
from app.storage.venues import get_venue
from app.vision.index import GlobalIndex

log = logging.getLogger("roomfix.maps")
CAPACITY = 16


class MapLibrary:
    """Gives the localizer of a venue's active map; holds the last 16 maps used, memory-mapped."""

    def __init__(self, resources: Resources) -> None:
        self._resources = resources
        self._lock = Lock()
        self._open: OrderedDict[str, Localizer] = OrderedDict()

    def active(self, venue_id: str) -> tuple[Localizer, MapVersion] | None:
        """Return the localizer and version that serve a venue, or None while it has no map.

        Raises `NotFoundError` for an unknown venue.
        """
        with self._resources.database.read() as connection:
            venue = get_venue(connection, venue_id)
            if venue.active_map_version is None:
                return None
            version = get_map(connection, venue_id, venue.active_map_version)
        return self._localizer(version), version

    def warm(self, venue_ids: Iterable[str]) -> None:
        """Open the maps of venues, so that their first query doesn't have to."""
        for venue_id in venue_ids:
            try:
                self.active(venue_id)
            except RoomfixError as error:
                log.warning("the map of venue %s can't be opened: %s", venue_id, error)

    def _localizer(self, version: MapVersion) -> Localizer:
        with self._lock:
            key = version.artifact_blob + version.index_blob
            localizer = self._open.get(key)
            if localizer is None:
                localizer = self._load(version)
                self._open[key] = localizer
            self._open.move_to_end(key)
            while len(self._open) > CAPACITY:
                self._open.popitem(last=False)
            return localizer

    def _load(self, version: MapVersion) -> Localizer:
        blobs = self._resources.blobs
        artifact = MapArtifact.open(blobs.local_path(version.artifact_blob))
        index = GlobalIndex.open(blobs.local_path(version.index_blob))
        # Reads every page of the index once, which the first query would wait for.
        index.search(index.descriptor(0), 1)
        return Localizer(artifact, index, self._resources.models)
