"""The maps that serve, opened once a process and kept while they are in use."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable
from dataclasses import dataclass

from app.engine.maps.open_map import OpenMap
from app.errors import ConflictError, MapDamagedError, RoomfixError
from app.limits import limit
from app.lru import LruCache
from app.services.resources import Resources
from app.storage.map_files import MapFiles
from app.storage.maps import MapVersion, active_version, list_maps

log = logging.getLogger("roomfix.maps")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapCacheOptions:
    """How much of the maps stays open."""

    open_bytes: int = limit(
        4_000_000_000,
        "Sum of the file sizes of the maps that are kept open, those used last.",
        chosen="By hand: map files are memory-mapped, so most of it is page cache that the system can take back.",
    )
    damage_memory_s: float = limit(
        30.0,
        "Time after which the files of a damaged map are tried again.",
        chosen="By hand: a repair is noticed soon, and queries meanwhile don't read the files again.",
    )


OPTIONS = MapCacheOptions()
DAMAGED_WHILE_OPEN = "A part of the map's file has another checksum than its contents."


@dataclass(frozen=True, slots=True)
class _Entry:
    """An open map and the size of its files."""

    opened: OpenMap
    file_bytes: int


@dataclass(frozen=True, slots=True)
class _Damage:
    """What was wrong with a map version, and when that was found, by a clock that counts seconds."""

    error: MapDamagedError
    found_s: float


class MapLibrary:
    """Gives the open map of a venue's active version; keeps the maps used last open, bounded by their size.

    A map that is being opened holds up only those who ask for it. Where the files of the active version are damaged
    the newest version before it that is whole serves.
    """

    def __init__(self, resources: Resources) -> None:
        self._resources = resources
        self._files = MapFiles(resources.blobs)
        self._open: LruCache[str, _Entry] = LruCache(OPTIONS.open_bytes, lambda entry: entry.file_bytes)
        self._damaged: dict[str, _Damage] = {}
        self._problems: dict[str, str] = {}

    @property
    def problems(self) -> dict[str, str]:
        """By venue: why its active version could not be opened when it was last asked for."""
        return dict(self._problems)

    def active(self, venue_id: str, *, is_whole: bool = False) -> tuple[OpenMap, MapVersion] | None:
        """Return the open map and the version that serve a venue, or None while it has no map.

        With `is_whole` no other version takes the place of a damaged one. Raises `NotFoundError` for an unknown venue,
        `MapDamagedError` when no version can serve.
        """
        with self._resources.database.read() as connection:
            version = active_version(connection, venue_id)
        if version is None:
            return None
        return (self.open(version), version) if is_whole else self.serving(version)

    def serving(self, active: MapVersion) -> tuple[OpenMap, MapVersion]:
        """Return the open map of a venue's active version, or of the newest one before it that is not damaged."""
        try:
            opened = self.open(active)
        except (MapDamagedError, ConflictError) as error:
            self._problems[active.venue_id] = f"Map version {active.version} can't be opened: {error}"
            if isinstance(error, ConflictError):
                raise
            return self._before(active, error)
        self._problems.pop(active.venue_id, None)
        return opened, active

    def warm(self, venue_ids: Iterable[str]) -> None:
        """Open the maps of venues, so that their first query doesn't have to."""
        for venue_id in venue_ids:
            try:
                self.active(venue_id)
            except RoomfixError as error:
                log.warning("the map of venue %s can't be opened: %s", venue_id, error)

    def open(self, version: MapVersion) -> OpenMap:
        """Return a version's map, opened when it is not open yet; raises `MapDamagedError`."""
        key = version.artifact_blob + version.index_blob
        known = self._damaged.get(key)
        if known is not None and time.monotonic() - known.found_s < OPTIONS.damage_memory_s:
            raise known.error
        try:
            opened = self._open.get_or_make(key, lambda: self._load(version)).opened
        except MapDamagedError as error:
            self._damaged[key] = _Damage(error, time.monotonic())
            raise
        if opened.artifact.is_damaged or opened.index.is_damaged:
            self._open.drop(key)
            self._damaged[key] = _Damage(MapDamagedError(DAMAGED_WHILE_OPEN), time.monotonic())
            raise self._damaged[key].error
        self._damaged.pop(key, None)
        return opened

    def _before(self, active: MapVersion, error: MapDamagedError) -> tuple[OpenMap, MapVersion]:
        with self._resources.database.read() as connection:
            earlier = [
                each for each in list_maps(connection, active.venue_id) if each.version < active.version
            ]
        for version in earlier:
            try:
                opened = self.open(version)
            except (MapDamagedError, ConflictError):
                continue
            problem = f"{error} Version {version.version} serves in place of version {active.version}."
            if self._problems.get(active.venue_id) != problem:
                log.error("venue %s: %s", active.venue_id, problem)
            self._problems[active.venue_id] = problem
            return opened, version
        log.error("venue %s has no map that can serve: %s", active.venue_id, error)
        raise MapDamagedError(
            f"The map of venue {active.venue_id!r} is damaged on the server, and no version before it can serve: "
            "restore the data folder from a backup, or build the map again. `roomfix check` says what is damaged."
        ) from error

    def _load(self, version: MapVersion) -> _Entry:
        artifact, index = self._files.open(version)
        # Reads every page of the index once, which the first query would wait for.
        index.search(index.descriptor(0), 1)
        opened = OpenMap.of(artifact, index, self._resources.models)
        return _Entry(opened, self._files.file_bytes(version))
