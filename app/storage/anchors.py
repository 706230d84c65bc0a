"""Anchors: monitoring cameras with their POIs, and the newest frame of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select, update

from app.engine.anchors.anchor import Anchor, AnchorSpec, Poi
from app.errors import ConflictError, NotFoundError
from app.geometry.camera import Camera
from app.geometry.camera_hint import CameraHint, hint_of, parse_camera_hint
from app.storage.db import as_utc, now
from app.storage.tables import anchor_frames, anchors


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorFrameRow:
    """The newest frame of an anchor, without its features."""

    anchor_id: str
    id: str
    received_at: datetime
    camera: Camera
    feature_count: int
    pois_visible: tuple[str, ...]
    image_blob: str | None


def put_anchor(connection: Connection, anchor_id: str, spec: AnchorSpec) -> Anchor:
    """Add or replace an anchor; raises `ConflictError` when another venue has the id.

    A changed anchor keeps its newest frame only while camera, POIs and position stay the same.
    """
    values = {**_columns(spec), "updated_at": now()}
    found = connection.execute(select(anchors).where(anchors.c.id == anchor_id)).first()
    if found is None:
        connection.execute(insert(anchors).values(id=anchor_id, uses=0, created_at=now(), **values))
        return get_anchor(connection, anchor_id)
    if found.venue_id != spec.venue_id:
        raise ConflictError(
            f"There is an anchor {anchor_id!r} in venue {found.venue_id!r}; delete it first or choose another id."
        )
    before = _anchor(found)
    if (before.spec.camera, before.spec.pois) != (spec.camera, spec.pois) or _moved(before.spec, spec):
        connection.execute(delete(anchor_frames).where(anchor_frames.c.anchor_id == anchor_id))
        values["calibration"] = None
    connection.execute(update(anchors).where(anchors.c.id == anchor_id).values(**values))
    return get_anchor(connection, anchor_id)


def get_anchor(connection: Connection, anchor_id: str) -> Anchor:
    """Return an anchor; raises `NotFoundError`."""
    row = connection.execute(select(anchors).where(anchors.c.id == anchor_id)).first()
    if row is None:
        raise NotFoundError(f"There is no anchor {anchor_id!r}; PUT it first.")
    return _anchor(row)


def list_anchors(connection: Connection, venue_id: str | None = None) -> list[Anchor]:
    """Return the anchors of a venue, or all, by their id."""
    query = select(anchors).order_by(anchors.c.id)
    if venue_id is not None:
        query = query.where(anchors.c.venue_id == venue_id)
    return [_anchor(row) for row in connection.execute(query)]


def delete_anchor(connection: Connection, anchor_id: str) -> None:
    """Delete an anchor with its frame; raises `NotFoundError`."""
    if connection.execute(delete(anchors).where(anchors.c.id == anchor_id)).rowcount == 0:
        raise NotFoundError(f"There is no anchor {anchor_id!r}.")


def set_calibration(connection: Connection, anchor_id: str, calibration: dict[str, Any] | None) -> Anchor:
    """Store the pose of the camera that was found in the map; raises `NotFoundError`."""
    connection.execute(update(anchors).where(anchors.c.id == anchor_id).values(calibration=calibration))
    return get_anchor(connection, anchor_id)


def count_uses(connection: Connection, anchor_ids: Sequence[str]) -> None:
    """Count that anchors have located a phone, and when."""
    used = anchors.c.id.in_(list(anchor_ids))
    connection.execute(update(anchors).where(used).values(uses=anchors.c.uses + 1, last_used_at=now()))


def set_frame(connection: Connection, frame: AnchorFrameRow, features: bytes) -> str | None:
    """Make a frame an anchor's newest one; return the image blob of the frame before when it is no longer needed."""
    before = connection.execute(
        select(anchor_frames.c.image_blob).where(anchor_frames.c.anchor_id == frame.anchor_id)
    ).scalar()
    connection.execute(delete(anchor_frames).where(anchor_frames.c.anchor_id == frame.anchor_id))
    connection.execute(
        insert(anchor_frames).values(
            anchor_id=frame.anchor_id,
            id=frame.id,
            received_at=frame.received_at,
            camera=hint_of(frame.camera).to_json(),
            feature_count=frame.feature_count,
            pois_visible=list(frame.pois_visible),
            features=features,
            image_blob=frame.image_blob,
        )
    )
    return None if before == frame.image_blob else before


def list_frames(connection: Connection, anchor_ids: Sequence[str]) -> dict[str, AnchorFrameRow]:
    """Return the newest frame of each of these anchors that has one."""
    columns = [column for column in anchor_frames.c if column.name != "features"]
    query = select(*columns).where(anchor_frames.c.anchor_id.in_(list(anchor_ids)))
    return {row.anchor_id: _frame(row) for row in connection.execute(query)}


def frame_features(connection: Connection, frame_id: str) -> bytes | None:
    """Return a frame's packed features, or None when a newer frame has replaced it."""
    query = select(anchor_frames.c.features).where(anchor_frames.c.id == frame_id)
    return connection.execute(query).scalar()


def _hint(value: Any) -> CameraHint:
    hint = parse_camera_hint(value)
    assert hint is not None  # noqa: S101 - the columns are not nullable
    return hint


def _moved(before: AnchorSpec, after: AnchorSpec) -> bool:
    places = [(spec.floor_id, spec.x, spec.y, spec.height_m) for spec in (before, after)]
    return places[0] != places[1]


def _columns(spec: AnchorSpec) -> dict[str, Any]:
    return {
        "venue_id": spec.venue_id,
        "floor_id": spec.floor_id,
        "x": spec.x,
        "y": spec.y,
        "height_m": spec.height_m,
        "heading_deg": spec.heading_deg,
        "camera": spec.camera.to_json(),
        "pois": [asdict(poi) for poi in spec.pois],
        "store_images": spec.store_images,
        "max_age_s": spec.max_age_s,
    }


def _anchor(row: Row[Any]) -> Anchor:
    pois = tuple(
        Poi(**{**poi, "region_px": tuple((float(u), float(v)) for u, v in poi["region_px"])})
        for poi in row.pois
    )
    spec = AnchorSpec(
        venue_id=row.venue_id,
        floor_id=row.floor_id,
        x=row.x,
        y=row.y,
        height_m=row.height_m,
        heading_deg=row.heading_deg,
        camera=_hint(row.camera),
        pois=pois,
        store_images=row.store_images,
        max_age_s=row.max_age_s,
    )
    created, updated = as_utc(row.created_at), as_utc(row.updated_at)
    assert created is not None  # noqa: S101 - the columns are not nullable
    assert updated is not None  # noqa: S101
    return Anchor(
        id=row.id,
        spec=spec,
        calibration=row.calibration,
        uses=row.uses,
        last_used_at=as_utc(row.last_used_at),
        created_at=created,
        updated_at=updated,
    )


def _frame(row: Row[Any]) -> AnchorFrameRow:
    received, camera = as_utc(row.received_at), _hint(row.camera).camera
    assert received is not None  # noqa: S101 - the column is not nullable
    assert camera is not None  # noqa: S101 - stored with its size
    return AnchorFrameRow(
        anchor_id=row.anchor_id,
        id=row.id,
        received_at=received,
        camera=camera,
        feature_count=row.feature_count,
        pois_visible=tuple(row.pois_visible),
        image_blob=row.image_blob,
    )
