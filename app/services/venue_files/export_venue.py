"""A venue becomes a file: a stream of its floors, plans, features, maps and monitoring cameras."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version

from sqlalchemy import Connection

from app.engine.anchors.anchor import Anchor
from app.engine.floors.earth import VenueOrigin
from app.engine.floors.floor import Floor
from app.errors import NotFoundError
from app.services.resources import Resources
from app.services.venue_files.archive import END, member, member_bytes
from app.services.venue_files.manifest import (
    BLOB_FOLDER,
    MANIFEST,
    MANIFEST_SHA256,
    AnchorEntry,
    FloorEntry,
    Manifest,
    MapEntry,
    OriginEntry,
    PlanEntry,
)
from app.storage.anchors import list_anchors
from app.storage.floors import get_features, list_floors
from app.storage.maps import MapVersion, list_keyframe_images, list_maps
from app.storage.venues import get_venue


@dataclass(frozen=True, slots=True)
class VenueFile:
    """A venue's file: how long it is, and its bytes, which are read from the store as they are asked for."""

    size: int
    chunks: Iterator[bytes]


def export_venue(resources: Resources, venue_id: str, *, active_only: bool = False) -> VenueFile:
    """Return the file of a venue as it is now; with `active_only` the map that serves is its only one.

    Raises `NotFoundError` for an unknown venue, and when a file in the store is missing. A blob that goes while the
    stream is read ends it early.
    """
    with resources.database.read() as connection:
        manifest = _manifest(connection, resources, venue_id, active_only=active_only)
    data = manifest.model_dump_json().encode()
    sha256 = hashlib.sha256(data).hexdigest().encode()
    sizes = [len(data), len(sha256), *manifest.blobs.values()]

    def chunks() -> Iterator[bytes]:
        yield from member(MANIFEST, len(data), [data])
        yield from member(MANIFEST_SHA256, len(sha256), [sha256])
        for digest, size in manifest.blobs.items():
            yield from member(BLOB_FOLDER + digest, size, resources.blobs.stream(digest))
        yield END

    return VenueFile(sum(map(member_bytes, sizes)) + len(END), chunks())


def _manifest(connection: Connection, resources: Resources, venue_id: str, *, active_only: bool) -> Manifest:
    venue = get_venue(connection, venue_id)
    maps = [
        _map(connection, each)
        for each in list_maps(connection, venue_id)
        if not active_only or each.version == venue.active_map_version
    ]
    floors = list_floors(connection, venue_id)
    manifest = Manifest(
        made_by=f"Roomfix {version('roomfix')}",
        id=venue.id,
        name=venue.name,
        active_map_version=venue.active_map_version,
        origin=_origin(venue.origin, floors),
        floors=[_floor(connection, floor) for floor in floors],
        maps=maps,
        anchors=[_anchor(anchor) for anchor in list_anchors(connection, venue_id)],
        blobs={},
    )
    sizes = {digest: resources.blobs.size(digest) for digest in sorted(manifest.needed_blobs())}
    missing = [digest for digest, size in sizes.items() if size is None]
    if missing:
        raise NotFoundError(
            f"{len(missing)} files of the venue are missing from the store; `roomfix check` says which and how to "
            "repair them."
        )
    return manifest.model_copy(update={"blobs": sizes})


def _origin(origin: VenueOrigin | None, floors: list[Floor]) -> OriginEntry | None:
    """Return the entry of an origin, None where there is none or its floor isn't there any more."""
    if origin is None or origin.floor not in {None, *(floor.id for floor in floors)}:
        return None
    return OriginEntry.model_validate(asdict(origin))


def _floor(connection: Connection, floor: Floor) -> FloorEntry:
    features = get_features(connection, floor.venue_id, floor.id)
    plan = None if floor.plan is None else PlanEntry.model_validate(asdict(floor.plan))
    return FloorEntry(
        id=floor.id,
        name=floor.name,
        level=floor.level,
        z_min_m=floor.z_min_m,
        z_max_m=floor.z_max_m,
        plan_from_world=None if floor.plan_from_world is None else floor.plan_from_world.tolist(),
        plan_residual_m=floor.plan_residual_m,
        plan=plan,
        features=None if features.sha256 is None else features.collection,
    )


def _map(connection: Connection, found: MapVersion) -> MapEntry:
    images = list_keyframe_images(connection, found.venue_id, found.version)
    return MapEntry(
        version=found.version,
        artifact_blob=found.artifact_blob,
        index_blob=found.index_blob,
        statistics=found.statistics,
        created_at=found.created_at,
        images=[(image.color_blob, image.depth_blob) for image in images],
    )


def _anchor(anchor: Anchor) -> AnchorEntry:
    values = asdict(anchor.spec)
    del values["venue_id"]
    values["camera"] = anchor.spec.camera.to_json()
    return AnchorEntry.model_validate({**values, "id": anchor.id, "calibration": anchor.calibration})
