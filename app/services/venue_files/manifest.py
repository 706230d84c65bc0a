"""What the file of a venue says of its contents: `venue.json`, the first member of the archive."""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from app.errors import InvalidInputError

FORMAT: Literal["roomfix-venue"] = "roomfix-venue"
VERSION: Literal[1] = 1
MANIFEST = "venue.json"
MANIFEST_SHA256 = "venue.json.sha256"
BLOB_FOLDER = "blobs/"

# As in the paths of the HTTP calls.
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, le=2**62)]


class Entry(BaseModel):
    """A part of the manifest: no names but its own."""

    model_config = ConfigDict(extra="forbid")


class GridEntry(Entry):
    """How a plan's tiles are cut."""

    width_px: Annotated[int, Field(ge=1, le=10**6)]
    height_px: Annotated[int, Field(ge=1, le=10**6)]
    tile_px: Annotated[int, Field(ge=64, le=4096)]


class TilesEntry(Entry):
    """The tiles of a plan of many pixels."""

    blob: Digest
    grid: GridEntry
    reduced_by: Annotated[int, Field(ge=1, le=1000)]


class PlanEntry(Entry):
    """A floor's plan image."""

    blob: Digest
    media_type: Literal["image/png", "image/jpeg"]
    width_px: Annotated[int, Field(ge=1, le=10**6)]
    height_px: Annotated[int, Field(ge=1, le=10**6)]
    meters_per_pixel: Annotated[float, Field(ge=1e-6, le=100)]
    origin_px: tuple[Number, Number]
    # Files of releases before tiles have none.
    tiles: TilesEntry | None = None

    def blobs(self) -> set[str]:
        """Return the SHA-256 of the plan's files."""
        return {self.blob} if self.tiles is None else {self.blob, self.tiles.blob}


class FloorEntry(Entry):
    """A floor, its plan and its features."""

    id: Id
    name: Name
    level: Annotated[int, Field(ge=-100, le=1000)]
    z_min_m: Number
    z_max_m: Number
    plan_from_world: list[list[Number]] | None
    plan_residual_m: Number | None
    plan: PlanEntry | None
    features: dict[str, Any] | None


class MapEntry(Entry):
    """A map version: its files, the statistics of its build, and colour and depth of each keyframe."""

    version: Annotated[int, Field(ge=1, le=2**31 - 1)]
    artifact_blob: Digest
    index_blob: Digest
    statistics: dict[str, Any]
    created_at: datetime
    images: list[tuple[Digest, Digest]]


class PoiEntry(Entry):
    """A POI of an anchor."""

    id: Id
    region_px: list[tuple[Number, Number]]
    x: Number
    y: Number
    distance_m: Number
    height_m: Number | None


class AnchorEntry(Entry):
    """A monitoring camera without its frames."""

    id: Id
    floor_id: Id
    x: Number
    y: Number
    height_m: Number
    heading_deg: Number | None
    camera: Any
    pois: list[PoiEntry]
    store_images: bool
    max_age_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None
    calibration: dict[str, Any] | None


class OriginEntry(Entry):
    """Where on Earth the venue lies."""

    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    height_m: Number
    heading_deg: Number
    floor: Id | None


class Manifest(Entry):
    """A venue: everything but keys, sessions, builds, frames of anchors and the audit log."""

    format: Literal["roomfix-venue"] = FORMAT
    version: Literal[1] = VERSION
    made_by: Annotated[str, Field(max_length=200)]
    id: Id
    name: Name
    active_map_version: int | None
    # Files of releases before origins have none.
    origin: OriginEntry | None = None
    floors: list[FloorEntry]
    maps: list[MapEntry]
    anchors: list[AnchorEntry]
    # The SHA-256 of every file in the archive, and its size in bytes.
    blobs: dict[Digest, Count]

    def needed_blobs(self) -> set[str]:
        """Return the SHA-256 of every blob that floors and maps refer to."""
        needed = {blob for floor in self.floors if floor.plan is not None for blob in floor.plan.blobs()}
        for entry in self.maps:
            needed |= {entry.artifact_blob, entry.index_blob}
            needed |= {digest for image in entry.images for digest in image}
        return needed


def parse_manifest(data: bytes, sha256: bytes) -> Manifest:
    """Return the manifest; raises `InvalidInputError` for one that is damaged, of another version or contradictory."""
    if hashlib.sha256(data).hexdigest().encode() != sha256.strip():
        raise InvalidInputError(f"{MANIFEST} is damaged: its SHA-256 is not the one in {MANIFEST_SHA256}.")
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        raise InvalidInputError(f"{MANIFEST} is not JSON.") from None
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InvalidInputError(f"{MANIFEST} is not of a file that a Roomfix server has exported.")
    if values.get("version") != VERSION:
        raise InvalidInputError(
            f"The file has version {str(values.get('version'))[:20]}; this server reads version {VERSION}. Export it "
            "with a server of this release, or import it with one of the release that wrote it."
        )
    try:
        manifest = Manifest.model_validate(values)
    except (ValidationError, RecursionError) as error:
        raise InvalidInputError(f"{MANIFEST} can't be used: {_first(error)}.") from None
    _check_consistent(manifest)
    return manifest


def _first(error: Exception) -> str:
    if not isinstance(error, ValidationError):
        return "it is nested too deeply"
    found = error.errors(include_url=False, include_input=False)[0]
    place = ".".join(str(part)[:40] for part in found["loc"])
    return f"{place}: {found['msg']}"


def _check_consistent(manifest: Manifest) -> None:
    for what, names in (
        ("floors", [floor.id for floor in manifest.floors]),
        ("maps", [str(entry.version) for entry in manifest.maps]),
        ("cameras", [anchor.id for anchor in manifest.anchors]),
    ):
        if len(set(names)) < len(names):
            raise InvalidInputError(f"{MANIFEST} names two {what} alike.")
    versions = {entry.version for entry in manifest.maps}
    if manifest.active_map_version is not None and manifest.active_map_version not in versions:
        raise InvalidInputError(f"{MANIFEST} names an active map that it doesn't have.")
    if manifest.origin is not None and manifest.origin.floor not in {None, *(f.id for f in manifest.floors)}:
        raise InvalidInputError(f"{MANIFEST} names a floor in its origin that it doesn't have.")
    if manifest.needed_blobs() != set(manifest.blobs):
        raise InvalidInputError(f"{MANIFEST} lists other files than its floors and maps refer to.")
