"""Monitoring cameras and their newest frames."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the tables."""
    op.create_table(
        "anchors",
        sa.Column("id", sa.String(64), nullable=False),
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("floor_id", sa.String(64), nullable=False),
        sa.Column("x", sa.Float(), nullable=False),
        sa.Column("y", sa.Float(), nullable=False),
        sa.Column("height_m", sa.Float(), nullable=False),
        sa.Column("heading_deg", sa.Float()),
        sa.Column("camera", sa.JSON(), nullable=False),
        sa.Column("pois", sa.JSON(), nullable=False),
        sa.Column("store_images", sa.Boolean(), nullable=False),
        sa.Column("max_age_s", sa.Float()),
        sa.Column("calibration", sa.JSON()),
        sa.Column("uses", sa.Integer(), nullable=False),
        sa.Column("last_used_at", sa.DateTime(timezone=True)),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("updated_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["venue_id", "floor_id"],
            ["floors.venue_id", "floors.id"],
            name="fk_anchors_venue_id",
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name="pk_anchors"),
    )
    op.create_index("ix_anchors_venue_id", "anchors", ["venue_id"])
    op.create_table(
        "anchor_frames",
        sa.Column("anchor_id", sa.String(64), nullable=False),
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("received_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("camera", sa.JSON(), nullable=False),
        sa.Column("feature_count", sa.Integer(), nullable=False),
        sa.Column("pois_visible", sa.JSON(), nullable=False),
        sa.Column("features", sa.LargeBinary(), nullable=False),
        sa.Column("image_blob", sa.String(64)),
        sa.ForeignKeyConstraint(
            ["anchor_id"], ["anchors.id"], name="fk_anchor_frames_anchor_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("anchor_id", name="pk_anchor_frames"),
    )


def downgrade() -> None:
    """Drop the tables."""
    op.drop_table("anchor_frames")
    op.drop_table("anchors")
