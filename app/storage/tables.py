"""The tables, as SQLAlchemy Core; `migrations/` creates them."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    DateTime,
    Float,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    false,
)

metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "ix": "ix_%(table_name)s_%(column_0_name)s",
    }
)

venues = Table(
    "venues",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("created_at", DateTime(timezone=True), nullable=False),
    # Not a foreign key: map_versions refers to venues already, and SQLite can't add the circle.
    Column("active_map_version", Integer),
    # Where on Earth it lies, as `VenueOrigin` has it.
    Column("origin", JSON(none_as_null=True)),
)

floors = Table(
    "floors",
    metadata,
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), primary_key=True),
    Column("id", String(64), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("level", Integer, nullable=False),
    Column("z_min_m", Float, nullable=False),
    Column("z_max_m", Float, nullable=False),
    Column("plan_from_world", JSON),
    Column("plan_residual_m", Float),
    Column("plan_blob", String(64)),
    Column("plan_media_type", String(32)),
    Column("plan_width_px", Integer),
    Column("plan_height_px", Integer),
    Column("plan_meters_per_pixel", Float),
    Column("plan_origin_px", JSON),
    Column("plan_tiles_blob", String(64)),
    Column("plan_tiles", JSON),
    Column("features", JSON),
    Column("features_sha256", String(64)),
)

builds = Table(
    "builds",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("state", String(16), nullable=False, index=True),
    Column("stage", String(32)),
    Column("done", Integer, nullable=False),
    Column("total", Integer, nullable=False),
    Column("options", JSON, nullable=False),
    Column("archive_blob", String(64), nullable=False),
    Column("kind", String(16), nullable=False, server_default="scan"),
    Column("priority", Integer, nullable=False, server_default="0"),
    Column("attempts", Integer, nullable=False),
    Column("cancel_requested", Boolean, nullable=False),
    Column("error_code", String(64)),
    Column("error", Text),
    Column("report", JSON),
    Column("map_version", Integer),
    Column("idempotency_key", String(64)),
    # While it runs: the worker that it belongs to, and how often its heart has beaten.
    Column("worker", String(200)),
    Column("heartbeat", Integer, nullable=False, server_default="0"),
    Column("created_at", DateTime(timezone=True), nullable=False),
    Column("started_at", DateTime(timezone=True)),
    Column("finished_at", DateTime(timezone=True)),
    Index("ix_builds_idempotency_key", "venue_id", "idempotency_key", unique=True),
)

map_versions = Table(
    "map_versions",
    metadata,
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("build_id", String(32)),
    Column("artifact_blob", String(64), nullable=False),
    Column("index_blob", String(64), nullable=False),
    Column("statistics", JSON, nullable=False),
    Column("created_at", DateTime(timezone=True), nullable=False),
)

keyframe_images = Table(
    "keyframe_images",
    metadata,
    Column("venue_id", String(64), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("keyframe", Integer, primary_key=True),
    Column("color_blob", String(64), nullable=False),
    Column("depth_blob", String(64), nullable=False),
    ForeignKeyConstraint(
        ["venue_id", "version"], ["map_versions.venue_id", "map_versions.version"], ondelete="CASCADE"
    ),
)

# Of the frames that a version's build left out, those of which a small picture is kept.
left_out_frames = Table(
    "left_out_frames",
    metadata,
    Column("venue_id", String(64), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("reason", String(32), nullable=False),
    Column("name", Text, nullable=False),
    Column("time_s", Float),
    Column("picture_blob", String(64), nullable=False),
    ForeignKeyConstraint(
        ["venue_id", "version"], ["map_versions.venue_id", "map_versions.version"], ondelete="CASCADE"
    ),
)

anchors = Table(
    "anchors",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("venue_id", String(64), nullable=False, index=True),
    Column("floor_id", String(64), nullable=False),
    Column("x", Float, nullable=False),
    Column("y", Float, nullable=False),
    Column("height_m", Float, nullable=False),
    Column("heading_deg", Float),
    Column("camera", JSON, nullable=False),
    Column("pois", JSON, nullable=False),
    Column("store_images", Boolean, nullable=False),
    Column("max_age_s", Float),
    Column("calibration", JSON),
    Column("uses", Integer, nullable=False),
    Column("last_used_at", DateTime(timezone=True)),
    Column("created_at", DateTime(timezone=True), nullable=False),
    Column("updated_at", DateTime(timezone=True), nullable=False),
    ForeignKeyConstraint(["venue_id", "floor_id"], ["floors.venue_id", "floors.id"], ondelete="CASCADE"),
)

# The newest frame of each monitoring camera: what it shows as features, the picture only where that is wanted.
anchor_frames = Table(
    "anchor_frames",
    metadata,
    Column("anchor_id", String(64), ForeignKey("anchors.id", ondelete="CASCADE"), primary_key=True),
    Column("id", String(32), nullable=False),
    Column("received_at", DateTime(timezone=True), nullable=False),
    Column("camera", JSON, nullable=False),
    Column("feature_count", Integer, nullable=False),
    Column("pois_visible", JSON, nullable=False),
    Column("features", LargeBinary, nullable=False),
    Column("image_blob", String(64)),
)

sessions = Table(
    "sessions",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), nullable=False, index=True),
    Column("camera", JSON),
    Column("destination", String(200)),
    Column("language", String(35)),
    Column("memory", JSON, nullable=False),
    Column("frames", Integer, nullable=False),
    # Whether its phone agreed to be shown to those who run the venue.
    Column("share", Boolean, nullable=False, server_default=false()),
    Column("created_at", DateTime(timezone=True), nullable=False),
    Column("active_at", DateTime(timezone=True), nullable=False, index=True),
)

session_points = Table(
    "session_points",
    metadata,
    Column("session_id", String(32), ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True),
    Column("frame", Integer, primary_key=True),
    Column("time_s", Float, nullable=False),
    Column("tracking", String(16), nullable=False),
    Column("pose", JSON),
    Column("floor", String(64)),
    Column("plan", JSON),
    Column("position_m", Float),
)

# A scan that a phone films in the browser: its frames, until a map of them has been built.
recordings = Table(
    "recordings",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), nullable=False, index=True),
    # The newest build that was made of it.
    Column("build_id", String(32)),
    Column("created_at", DateTime(timezone=True), nullable=False),
    Column("active_at", DateTime(timezone=True), nullable=False, index=True),
)

recording_frames = Table(
    "recording_frames",
    metadata,
    Column("recording_id", String(32), ForeignKey("recordings.id", ondelete="CASCADE"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("picture_blob", String(64), nullable=False),
    Column("bytes", Integer, nullable=False),
    Column("time_s", Float, nullable=False),
    # Down in the camera's axes, where the phone knows it.
    Column("down", JSON(none_as_null=True)),
)

# Keys and the short-lived tokens made with them. A key itself is nowhere stored, only the SHA-256 of its secret.
keys = Table(
    "keys",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("secret_sha256", String(64), nullable=False),
    Column("kind", String(8), nullable=False),
    Column("name", String(200), nullable=False),
    Column("scope", String(16), nullable=False),
    Column("venue_id", String(64), ForeignKey("venues.id", ondelete="CASCADE"), index=True),
    Column("camera_id", String(64)),
    # The key that a token was made with.
    Column("parent_id", String(16), ForeignKey("keys.id", ondelete="CASCADE"), index=True),
    Column("created_by", String(200), nullable=False),
    Column("created_at", DateTime(timezone=True), nullable=False),
    Column("expires_at", DateTime(timezone=True)),
    Column("revoked_at", DateTime(timezone=True)),
    Column("last_used_at", DateTime(timezone=True)),
)

# Acts of administrators. No foreign keys: an entry outlives the venue and the key that it is about.
audit = Table(
    "audit",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("at", DateTime(timezone=True), nullable=False),
    Column("key_id", String(16)),
    Column("key_name", String(200), nullable=False),
    Column("act", String(100), nullable=False),
    Column("target", String(300), nullable=False),
    Column("venue_id", String(64), index=True),
    Column("address", String(64)),
)
