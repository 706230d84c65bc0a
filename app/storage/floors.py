"""Floors: heights, `plan_from_world`, the plan image and the features."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row, delete, insert, select, update

from app.engine.floors.floor import Floor, PlanImage, PlanTiles
from app.errors import NotFoundError
from app.importers.plan_images.tiles import TileGrid
from app.storage.tables import floors

# Features can be megabytes and are not needed to list the floors, which every query does.
ALL_BUT_FEATURES = [column for column in floors.c if column.name != "features"]


@dataclass(frozen=True, slots=True)
class Features:
    """A GeoJSON FeatureCollection in plan metres, and its digest, None for a floor without features."""

    collection: dict[str, Any]
    sha256: str | None


def put_floor(
    connection: Connection,
    venue_id: str,
    floor_id: str,
    *,
    name: str,
    level: int,
    z_min_m: float,
    z_max_m: float,
    plan_from_world: NDArray[np.float64] | None,
    plan_residual_m: float | None,
) -> Floor:
    """Add a floor, or change it and keep its plan image and features."""
    values = {
        "name": name,
        "level": level,
        "z_min_m": z_min_m,
        "z_max_m": z_max_m,
        "plan_from_world": None if plan_from_world is None else plan_from_world.tolist(),
        "plan_residual_m": plan_residual_m,
    }
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    if connection.execute(update(floors).where(here).values(**values)).rowcount == 0:
        connection.execute(insert(floors).values(venue_id=venue_id, id=floor_id, **values))
    return get_floor(connection, venue_id, floor_id)


def set_plan_image(connection: Connection, venue_id: str, floor_id: str, plan: PlanImage) -> Floor:
    """Give a floor its plan image; raises `NotFoundError`."""
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    connection.execute(
        update(floors)
        .where(here)
        .values(
            plan_blob=plan.blob,
            plan_media_type=plan.media_type,
            plan_width_px=plan.width_px,
            plan_height_px=plan.height_px,
            plan_meters_per_pixel=plan.meters_per_pixel,
            plan_origin_px=list(plan.origin_px),
            plan_tiles_blob=None if plan.tiles is None else plan.tiles.blob,
            plan_tiles=None
            if plan.tiles is None
            else {**asdict(plan.tiles.grid), "reduced_by": plan.tiles.reduced_by},
        )
    )
    return get_floor(connection, venue_id, floor_id)


def set_features(connection: Connection, venue_id: str, floor_id: str, features: dict[str, Any]) -> Floor:
    """Give a floor its GeoJSON features; raises `NotFoundError`."""
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    digest = hashlib.sha256(json.dumps(features, sort_keys=True).encode()).hexdigest()
    connection.execute(update(floors).where(here).values(features=features, features_sha256=digest))
    return get_floor(connection, venue_id, floor_id)


def get_features(connection: Connection, venue_id: str, floor_id: str) -> Features:
    """Return a floor's features, an empty collection when it has none; raises `NotFoundError`."""
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    row = connection.execute(select(floors.c.features, floors.c.features_sha256).where(here)).first()
    if row is None:
        raise _unknown(venue_id, floor_id)
    return Features(row.features or {"type": "FeatureCollection", "features": []}, row.features_sha256)


def get_floor(connection: Connection, venue_id: str, floor_id: str) -> Floor:
    """Return a floor; raises `NotFoundError`."""
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    row = connection.execute(select(*ALL_BUT_FEATURES).where(here)).first()
    if row is None:
        raise _unknown(venue_id, floor_id)
    return _floor(row)


def list_floors(connection: Connection, venue_id: str) -> list[Floor]:
    """Return a venue's floors, lowest first."""
    query = (
        select(*ALL_BUT_FEATURES).where(floors.c.venue_id == venue_id).order_by(floors.c.level, floors.c.id)
    )
    return [_floor(row) for row in connection.execute(query)]


def delete_floor(connection: Connection, venue_id: str, floor_id: str) -> None:
    """Delete a floor; raises `NotFoundError`."""
    here = (floors.c.venue_id == venue_id) & (floors.c.id == floor_id)
    if connection.execute(delete(floors).where(here)).rowcount == 0:
        raise _unknown(venue_id, floor_id)


def _unknown(venue_id: str, floor_id: str) -> NotFoundError:
    return NotFoundError(f"Venue {venue_id!r} has no floor {floor_id!r}.")


def _tiles(blob: str, values: dict[str, int]) -> PlanTiles:
    grid = TileGrid(values["width_px"], values["height_px"], values["tile_px"])
    return PlanTiles(blob=blob, grid=grid, reduced_by=values["reduced_by"])


def _floor(row: Row[tuple[Any, ...]]) -> Floor:
    plan = None
    if row.plan_blob is not None:
        plan = PlanImage(
            blob=row.plan_blob,
            media_type=row.plan_media_type,
            width_px=row.plan_width_px,
            height_px=row.plan_height_px,
            meters_per_pixel=row.plan_meters_per_pixel,
            origin_px=(row.plan_origin_px[0], row.plan_origin_px[1]),
            tiles=None if row.plan_tiles_blob is None else _tiles(row.plan_tiles_blob, row.plan_tiles),
        )
    matrix = None if row.plan_from_world is None else np.array(row.plan_from_world, dtype=np.float64)
    return Floor(
        venue_id=row.venue_id,
        id=row.id,
        name=row.name,
        level=row.level,
        z_min_m=row.z_min_m,
        z_max_m=row.z_max_m,
        plan_from_world=matrix,
        plan_residual_m=row.plan_residual_m,
        plan=plan,
        features_sha256=row.features_sha256,
    )
