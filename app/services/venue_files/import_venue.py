"""A file becomes a venue: everything in it is verified before anything of it can be seen."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from sqlalchemy import Connection

from app.engine.anchors.anchor import AnchorSpec, Poi
from app.engine.anchors.check_anchor import check_anchor
from app.engine.floors.checks import check_links
from app.engine.floors.collection import read_collection
from app.engine.floors.earth import VenueOrigin
from app.engine.floors.floor import PlanImage, PlanTiles
from app.engine.floors.plan_alignment import parse_plan_from_world
from app.engine.navigation.network import check_walkable
from app.errors import ConflictError, InvalidInputError, MapDamagedError, NotFoundError, RoomfixError
from app.geometry.camera_hint import parse_camera_hint
from app.importers.plan_images.tiles import TileGrid, check_tiles
from app.limits import limit
from app.services.resources import Resources
from app.services.venue_files.archive import Member, members
from app.services.venue_files.manifest import (
    BLOB_FOLDER,
    MANIFEST,
    MANIFEST_SHA256,
    AnchorEntry,
    FloorEntry,
    Manifest,
    PlanEntry,
    parse_manifest,
)
from app.storage.anchors import get_anchor, put_anchor, set_calibration
from app.storage.db import hold_blobs
from app.storage.floors import get_floor, put_floor, set_features, set_plan_image
from app.storage.map_files import MapFiles
from app.storage.maps import KeyframeImages, MapVersion, add_map
from app.storage.sweep import discard_blobs
from app.storage.venues import Venue, check_id, create_venue, get_venue, place_venue, set_active_map
from app.vision.images import decode_image

# Raises for statistics of a map that can't be shown.
CheckStatistics = Callable[[dict[str, Any]], object]
SCRATCH_PREFIX = "upload-"


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What the file of a venue may hold."""

    max_manifest_bytes: int = limit(
        256_000_000,
        "Largest `venue.json` of a venue's file, which is read into memory.",
        chosen="By hand: ten floors of 25 MB of features, the most that a floor may have.",
    )


OPTIONS = ImportOptions()


@dataclass(frozen=True, slots=True)
class ImportedVenue:
    """A venue that was imported; `cameras` are the ids that its monitoring cameras had, and have now."""

    venue: Venue
    floors: int
    maps: int
    cameras: dict[str, str]


def import_venue(
    resources: Resources, file: BinaryIO, check_statistics: CheckStatistics, as_id: str | None = None
) -> ImportedVenue:
    """Add the venue of a file, under another id if one is given.

    The rows become visible in one transaction, after every checksum, map, plan, feature and camera was verified; a
    process that is killed before leaves only files that nothing refers to, which the sweep deletes. With `as_id` the
    cameras whose ids are taken get the id `AS_ID-CAMERA`. Raises `InvalidInputError` for a file that can't be used,
    and `ConflictError` for ids that are taken.
    """
    archive = members(file)
    manifest = _read_manifest(archive)
    venue_id = as_id or manifest.id
    check_id(venue_id)
    _check_contents(manifest, check_statistics)
    with resources.database.read() as connection:
        _refuse_taken(connection, venue_id)
        _camera_ids(connection, manifest, venue_id, may_rename=as_id is not None)
    stored: set[str] = set()
    try:
        for member in archive:
            stored.add(_store_blob(resources, manifest, member, stored))
        _check_files(resources, manifest, stored)
        cameras = _publish(resources, manifest, venue_id, may_rename=as_id is not None)
    except BaseException:
        # What remains when this fails too, the sweep deletes.
        with suppress(RoomfixError, OSError):
            discard_blobs(resources.database, resources.blobs, stored, written_by="")
        raise
    with resources.database.read() as connection:
        venue = get_venue(connection, venue_id)
    return ImportedVenue(venue, len(manifest.floors), len(manifest.maps), cameras)


def _publish(resources: Resources, manifest: Manifest, venue_id: str, *, may_rename: bool) -> dict[str, str]:
    """Add all rows in one transaction; return the new id of each camera."""
    with resources.database.write() as connection:
        hold_blobs(connection)
        if not all(map(resources.blobs.contains, manifest.blobs)):
            raise ConflictError("Files of the venue were deleted while it was imported; import it again.")
        cameras = _camera_ids(connection, manifest, venue_id, may_rename=may_rename)
        _add_rows(connection, manifest, venue_id, cameras)
    return cameras


def _read_manifest(archive: Iterator[Member]) -> Manifest:
    parts = []
    for name, max_bytes in ((MANIFEST, OPTIONS.max_manifest_bytes), (MANIFEST_SHA256, 100)):
        member = next(archive, None)
        if member is None or member.name != name:
            raise InvalidInputError(f"This is no file of a venue: {name} is not where it must be.")
        if member.size > max_bytes:
            raise InvalidInputError(f"{name} is larger than {max_bytes:,} bytes.")
        parts.append(b"".join(member.chunks))
    return parse_manifest(*parts)


def _check_contents(manifest: Manifest, check_statistics: CheckStatistics) -> None:
    """Check all that can be checked before the files are read."""
    ids = [floor.id for floor in manifest.floors]
    for floor in manifest.floors:
        if floor.z_min_m >= floor.z_max_m:
            raise InvalidInputError(f"Floor {floor.id}: z_min_m must be below z_max_m.")
        parse_plan_from_world(floor.plan_from_world)
        if floor.features is not None:
            _, features = read_collection(floor.features, floor.id)
            check_links(features, ids)
            check_walkable(features)
    for anchor in manifest.anchors:
        if anchor.floor_id not in ids:
            raise InvalidInputError(
                f"Camera {anchor.id} is on the floor {anchor.floor_id}, which the file lacks."
            )
        if parse_camera_hint(anchor.camera) is None:
            raise InvalidInputError(f"Camera {anchor.id} has no intrinsics.")
    for entry in manifest.maps:
        try:
            check_statistics(entry.statistics)
        except ValueError:
            raise InvalidInputError(f"Map {entry.version}: its statistics can't be read.") from None


def _refuse_taken(connection: Connection, venue_id: str) -> None:
    with suppress(NotFoundError):
        get_venue(connection, venue_id)
        raise ConflictError(f"There is a venue {venue_id!r} already: import the file as another one.")


def _camera_ids(
    connection: Connection, manifest: Manifest, venue_id: str, *, may_rename: bool
) -> dict[str, str]:
    """Return the new id of each camera of the file."""
    ids = {}
    for anchor in manifest.anchors:
        new = anchor.id
        if _is_taken(connection, new):
            new = f"{venue_id}-{anchor.id}"
            if not may_rename or len(new) > 64 or _is_taken(connection, new):
                raise ConflictError(
                    f"There is a monitoring camera {anchor.id!r} in another venue: delete it, or import the file as "
                    "another venue, which renames cameras."
                )
        ids[anchor.id] = new
    if len(set(ids.values())) < len(ids):
        raise ConflictError(
            "Two monitoring cameras would have the same id; import the file as another venue."
        )
    return ids


def _is_taken(connection: Connection, anchor_id: str) -> bool:
    try:
        get_anchor(connection, anchor_id)
    except NotFoundError:
        return False
    return True


def _store_blob(resources: Resources, manifest: Manifest, member: Member, stored: set[str]) -> str:
    """Verify a file of the archive and store it; return its SHA-256."""
    digest = member.name.removeprefix(BLOB_FOLDER)
    if member.name != BLOB_FOLDER + digest or digest not in manifest.blobs or digest in stored:
        raise InvalidInputError(
            f"The file holds {member.name[:80]!r}, which {MANIFEST} doesn't list, or twice."
        )
    if member.size != manifest.blobs[digest]:
        raise InvalidInputError(f"{member.name} has another size than {MANIFEST} says.")
    hasher = hashlib.sha256()
    with tempfile.NamedTemporaryFile(dir=resources.scratch_dir, prefix=SCRATCH_PREFIX) as file:
        for chunk in member.chunks:
            hasher.update(chunk)
            file.write(chunk)
        if hasher.hexdigest() != digest:
            raise InvalidInputError(f"{member.name} is damaged: it has another SHA-256.")
        file.flush()
        return resources.blobs.put_file(Path(file.name))


def _check_files(resources: Resources, manifest: Manifest, stored: set[str]) -> None:
    if len(stored) < len(manifest.blobs):
        raise InvalidInputError(f"The file lacks {len(manifest.blobs) - len(stored)} of the files it lists.")
    _check_plans(resources, manifest)
    _check_maps(resources, manifest)


def _check_plans(resources: Resources, manifest: Manifest) -> None:
    for floor in manifest.floors:
        if floor.plan is None:
            continue
        picture = decode_image(resources.blobs.get(floor.plan.blob), resources.settings.max_image_pixels)
        if picture.shape[:2] != (floor.plan.height_px, floor.plan.width_px):
            raise InvalidInputError(f"The plan of floor {floor.id} has another size than {MANIFEST} says.")
        plan = _plan_image(floor.plan)
        if plan.tiles is None:
            continue
        grid, factor = plan.tiles.grid, plan.tiles.reduced_by
        if (-(-grid.width_px // factor), -(-grid.height_px // factor)) != (plan.width_px, plan.height_px):
            raise InvalidInputError(f"The tiles of floor {floor.id} are of another picture than its plan.")
        check_tiles(resources.blobs.local_path(plan.tiles.blob), grid)


def _plan_image(entry: PlanEntry) -> PlanImage:
    values = entry.model_dump(exclude={"tiles"})
    if entry.tiles is None:
        return PlanImage(**values)
    grid = TileGrid(**entry.tiles.grid.model_dump())
    tiles = PlanTiles(blob=entry.tiles.blob, grid=grid, reduced_by=entry.tiles.reduced_by)
    return PlanImage(**values, tiles=tiles)


def _check_maps(resources: Resources, manifest: Manifest) -> None:
    files = MapFiles(resources.blobs)
    for entry in manifest.maps:
        version = _version(manifest.id, entry.version, manifest)
        try:
            artifact, index = files.open(version)
            keyframes = artifact.keyframe_count
        except (MapDamagedError, ValueError, KeyError, TypeError):
            raise InvalidInputError(f"Map {entry.version} can't be opened by this server.") from None
        if len(index) != keyframes or len(entry.images) not in (0, keyframes):
            raise InvalidInputError(
                f"Map {entry.version} has {keyframes} keyframes, its index {len(index)} and {len(entry.images)} "
                "pictures."
            )


def _version(venue_id: str, number: int, manifest: Manifest) -> MapVersion:
    entry = next(entry for entry in manifest.maps if entry.version == number)
    return MapVersion(
        venue_id=venue_id,
        version=entry.version,
        build_id=None,
        artifact_blob=entry.artifact_blob,
        index_blob=entry.index_blob,
        statistics=entry.statistics,
        created_at=entry.created_at,
    )


def _add_rows(connection: Connection, manifest: Manifest, venue_id: str, cameras: dict[str, str]) -> None:
    create_venue(connection, venue_id, manifest.name)
    for floor in manifest.floors:
        _add_floor(connection, venue_id, floor)
    if manifest.origin is not None:
        place_venue(connection, venue_id, VenueOrigin(**manifest.origin.model_dump()))
    for entry in manifest.maps:
        images = [KeyframeImages(color, depth) for color, depth in entry.images]
        add_map(connection, _version(venue_id, entry.version, manifest), images)
    if manifest.active_map_version is not None:
        set_active_map(connection, venue_id, manifest.active_map_version)
    for anchor in manifest.anchors:
        spec = _spec(anchor, venue_id)
        check_anchor(spec, get_floor(connection, venue_id, anchor.floor_id))
        put_anchor(connection, cameras[anchor.id], spec)
        set_calibration(connection, cameras[anchor.id], anchor.calibration)


def _add_floor(connection: Connection, venue_id: str, floor: FloorEntry) -> None:
    alignment = parse_plan_from_world(floor.plan_from_world)
    put_floor(
        connection,
        venue_id,
        floor.id,
        name=floor.name,
        level=floor.level,
        z_min_m=floor.z_min_m,
        z_max_m=floor.z_max_m,
        plan_from_world=None if alignment is None else alignment.matrix,
        plan_residual_m=floor.plan_residual_m,
    )
    if floor.plan is not None:
        set_plan_image(connection, venue_id, floor.id, _plan_image(floor.plan))
    if floor.features is not None:
        set_features(connection, venue_id, floor.id, floor.features)


def _spec(anchor: AnchorEntry, venue_id: str) -> AnchorSpec:
    camera = parse_camera_hint(anchor.camera)
    assert camera is not None  # noqa: S101 - `_check_contents` refuses it
    return AnchorSpec(
        venue_id=venue_id,
        floor_id=anchor.floor_id,
        x=anchor.x,
        y=anchor.y,
        height_m=anchor.height_m,
        heading_deg=anchor.heading_deg,
        camera=camera,
        pois=tuple(Poi(**{**poi.model_dump(), "region_px": tuple(poi.region_px)}) for poi in anchor.pois),
        store_images=anchor.store_images,
        max_age_s=anchor.max_age_s,
    )
