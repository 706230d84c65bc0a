"""Venues, floors, builds, map versions and the images of their keyframes."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the tables."""
    op.create_table(
        "venues",
        sa.Column("id", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("active_map_version", sa.Integer()),
        sa.PrimaryKeyConstraint("id", name="pk_venues"),
    )
    op.create_table(
        "floors",
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("id", sa.String(64), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("level", sa.Integer(), nullable=False),
        sa.Column("z_min_m", sa.Float(), nullable=False),
        sa.Column("z_max_m", sa.Float(), nullable=False),
        sa.Column("plan_from_world", sa.JSON()),
        sa.Column("plan_residual_m", sa.Float()),
        sa.Column("plan_blob", sa.String(64)),
        sa.Column("plan_media_type", sa.String(32)),
        sa.Column("plan_width_px", sa.Integer()),
        sa.Column("plan_height_px", sa.Integer()),
        sa.Column("plan_meters_per_pixel", sa.Float()),
        sa.Column("plan_origin_px", sa.JSON()),
        sa.Column("features", sa.JSON()),
        sa.ForeignKeyConstraint(["venue_id"], ["venues.id"], name="fk_floors_venue_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("venue_id", "id", name="pk_floors"),
    )
    op.create_table(
        "builds",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("stage", sa.String(32)),
        sa.Column("done", sa.Integer(), nullable=False),
        sa.Column("total", sa.Integer(), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("archive_blob", sa.String(64), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("cancel_requested", sa.Boolean(), nullable=False),
        sa.Column("error_code", sa.String(64)),
        sa.Column("error", sa.Text()),
        sa.Column("report", sa.JSON()),
        sa.Column("map_version", sa.Integer()),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True)),
        sa.Column("finished_at", sa.DateTime(timezone=True)),
        sa.ForeignKeyConstraint(["venue_id"], ["venues.id"], name="fk_builds_venue_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name="pk_builds"),
    )
    op.create_index("ix_builds_venue_id", "builds", ["venue_id"])
    op.create_index("ix_builds_state", "builds", ["state"])
    op.create_table(
        "map_versions",
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("build_id", sa.String(32)),
        sa.Column("artifact_blob", sa.String(64), nullable=False),
        sa.Column("index_blob", sa.String(64), nullable=False),
        sa.Column("statistics", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["venue_id"], ["venues.id"], name="fk_map_versions_venue_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("venue_id", "version", name="pk_map_versions"),
    )
    op.create_table(
        "keyframe_images",
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("keyframe", sa.Integer(), nullable=False),
        sa.Column("color_blob", sa.String(64), nullable=False),
        sa.Column("depth_blob", sa.String(64), nullable=False),
        sa.ForeignKeyConstraint(
            ["venue_id", "version"],
            ["map_versions.venue_id", "map_versions.version"],
            name="fk_keyframe_images_venue_id",
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("venue_id", "version", "keyframe", name="pk_keyframe_images"),
    )


def downgrade() -> None:
    """Drop the tables."""
    for table in ("keyframe_images", "map_versions", "builds", "floors", "venues"):
        op.drop_table(table)
