"""Map versions: they never change, and one of them serves the venue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal

from sqlalchemy import Connection, Row, delete, func, insert, select

from app.errors import ConflictError, NotFoundError
from app.storage.db import as_utc, now
from app.storage.tables import builds, keyframe_images, left_out_frames, map_versions, venues
from app.storage.venues import get_venue, set_active_map


@dataclass(frozen=True, slots=True, kw_only=True)
class MapVersion:
    """A map version: its blobs and the statistics of its build."""

    venue_id: str
    version: int
    build_id: str | None
    artifact_blob: str
    index_blob: str
    statistics: dict[str, Any]
    created_at: datetime

    @property
    def z_up(self) -> bool:
        """Whether the z axis of the map's world is known to point up: by gravity or `world_from_scan` of its own scan,
        or of the scan that it was registered to."""
        placement = self.statistics.get("placement", {})
        return bool(placement.get("z_up", placement.get("source") in ("given", "gravity")))

    @property
    def has_scale(self) -> bool:
        """Whether the map is in metres; else it is in a unit of its own."""
        return bool(self.statistics.get("placement", {}).get("has_scale", True))

    @property
    def plan_reason(self) -> Literal["up_unknown", "scale_unknown"] | None:
        """Why poses in the map have no plan position, None where they have."""
        if not self.has_scale:
            return "scale_unknown"
        return None if self.z_up else "up_unknown"


@dataclass(frozen=True, slots=True)
class KeyframeImages:
    """The stored pictures of a keyframe, as blobs."""

    color_blob: str
    depth_blob: str


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptFrame:
    """A frame that a version's build left out: why, its name, its time since the scan's first frame if known, and the
    blob of its picture, a JPEG."""

    reason: str
    name: str
    time_s: float | None
    picture_blob: str


def publish_map(
    connection: Connection,
    venue_id: str,
    build_id: str,
    artifact_blob: str,
    index_blob: str,
    statistics: dict[str, Any],
    images: Sequence[KeyframeImages],
) -> int:
    """Add the next version of a venue's map, make it the one that serves, and return its number."""
    version = MapVersion(
        venue_id=venue_id,
        version=_newest_number(connection, venue_id) + 1,
        build_id=build_id,
        artifact_blob=artifact_blob,
        index_blob=index_blob,
        statistics=statistics,
        created_at=now(),
    )
    add_map(connection, version, images)
    set_active_map(connection, venue_id, version.version)
    return version.version


def add_map(connection: Connection, version: MapVersion, images: Sequence[KeyframeImages]) -> None:
    """Add a map version and the pictures of its keyframes; it doesn't serve by that."""
    connection.execute(
        insert(map_versions).values(
            venue_id=version.venue_id,
            version=version.version,
            build_id=version.build_id,
            artifact_blob=version.artifact_blob,
            index_blob=version.index_blob,
            statistics=version.statistics,
            created_at=version.created_at,
        )
    )
    if images:
        rows = [
            {
                "venue_id": version.venue_id,
                "version": version.version,
                "keyframe": keyframe,
                "color_blob": image.color_blob,
                "depth_blob": image.depth_blob,
            }
            for keyframe, image in enumerate(images)
        ]
        connection.execute(insert(keyframe_images), rows)


def _newest_number(connection: Connection, venue_id: str) -> int:
    """Return the largest number that a version of a venue's map has, or had before it was deleted; 0 without any."""
    numbers = (
        select(func.max(map_versions.c.version)).where(map_versions.c.venue_id == venue_id),
        select(func.max(builds.c.map_version)).where(builds.c.venue_id == venue_id),
    )
    return max(connection.execute(query).scalar() or 0 for query in numbers)


def delete_map(connection: Connection, venue_id: str, version: int) -> None:
    """Delete a map version; its blobs go with the next sweep.

    Raises `NotFoundError`, and `ConflictError` for the version that serves.
    """
    get_map(connection, venue_id, version)
    if get_venue(connection, venue_id).active_map_version == version:
        raise ConflictError(f"Map version {version} serves the venue: activate another one first.")
    here = (map_versions.c.venue_id == venue_id) & (map_versions.c.version == version)
    connection.execute(delete(map_versions).where(here))


def active_version(connection: Connection, venue_id: str) -> MapVersion | None:
    """Return the version that serves a venue, None while it has no map; raises `NotFoundError` for an unknown venue."""
    serves = (venues.c.id == map_versions.c.venue_id) & (
        venues.c.active_map_version == map_versions.c.version
    )
    row = connection.execute(select(map_versions).join(venues, serves).where(venues.c.id == venue_id)).first()
    if row is None:
        get_venue(connection, venue_id)
        return None
    return _map(row)


def get_map(connection: Connection, venue_id: str, version: int) -> MapVersion:
    """Return a map version; raises `NotFoundError`."""
    here = (map_versions.c.venue_id == venue_id) & (map_versions.c.version == version)
    row = connection.execute(select(map_versions).where(here)).first()
    if row is None:
        raise NotFoundError(f"Venue {venue_id!r} has no map version {version}.")
    return _map(row)


def list_maps(connection: Connection, venue_id: str) -> list[MapVersion]:
    """Return a venue's map versions, newest first."""
    query = (
        select(map_versions)
        .where(map_versions.c.venue_id == venue_id)
        .order_by(map_versions.c.version.desc())
    )
    return [_map(row) for row in connection.execute(query)]


def list_keyframe_images(connection: Connection, venue_id: str, version: int) -> list[KeyframeImages]:
    """Return the pictures of a map's keyframes in order; empty for a map that was built without them."""
    query = (
        select(keyframe_images)
        .where((keyframe_images.c.venue_id == venue_id) & (keyframe_images.c.version == version))
        .order_by(keyframe_images.c.keyframe)
    )
    return [KeyframeImages(row.color_blob, row.depth_blob) for row in connection.execute(query)]


def get_keyframe_images(
    connection: Connection, venue_id: str, version: int, keyframe: int
) -> KeyframeImages | None:
    """Return the pictures of one keyframe of a map, None for a map that was built without them."""
    query = select(keyframe_images).where(
        (keyframe_images.c.venue_id == venue_id)
        & (keyframe_images.c.version == version)
        & (keyframe_images.c.keyframe == keyframe)
    )
    row = connection.execute(query).first()
    return None if row is None else KeyframeImages(row.color_blob, row.depth_blob)


def add_left_out(connection: Connection, venue_id: str, version: int, frames: Sequence[KeptFrame]) -> None:
    """Add the frames that the build of a version left out and keeps a picture of."""
    rows = [
        {"venue_id": venue_id, "version": version, "number": number, **asdict(frame)}
        for number, frame in enumerate(frames)
    ]
    if rows:
        connection.execute(insert(left_out_frames), rows)


def list_left_out(connection: Connection, venue_id: str, version: int) -> list[KeptFrame]:
    """Return the frames of a version by their numbers; empty for one that keeps no pictures."""
    query = (
        select(left_out_frames)
        .where((left_out_frames.c.venue_id == venue_id) & (left_out_frames.c.version == version))
        .order_by(left_out_frames.c.number)
    )
    return [
        KeptFrame(reason=row.reason, name=row.name, time_s=row.time_s, picture_blob=row.picture_blob)
        for row in connection.execute(query)
    ]


def _map(row: Row[tuple[Any, ...]]) -> MapVersion:
    created = as_utc(row.created_at)
    assert created is not None  # noqa: S101 - the column is not nullable
    return MapVersion(
        venue_id=row.venue_id,
        version=row.version,
        build_id=row.build_id,
        artifact_blob=row.artifact_blob,
        index_blob=row.index_blob,
        statistics=row.statistics,
        created_at=created,
    )
