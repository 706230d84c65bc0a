"""Scans that a phone films in the browser: recordings and their frames."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the tables."""
    op.create_table(
        "recordings",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("venue_id", sa.String(64), sa.ForeignKey("venues.id", ondelete="CASCADE"), nullable=False),
        sa.Column("build_id", sa.String(32)),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("active_at", sa.DateTime(timezone=True), nullable=False),
    )
    op.create_index("ix_recordings_venue_id", "recordings", ["venue_id"])
    op.create_index("ix_recordings_active_at", "recordings", ["active_at"])
    op.create_table(
        "recording_frames",
        sa.Column(
            "recording_id",
            sa.String(32),
            sa.ForeignKey("recordings.id", ondelete="CASCADE"),
            primary_key=True,
        ),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("picture_blob", sa.String(64), nullable=False),
        sa.Column("bytes", sa.Integer, nullable=False),
        sa.Column("time_s", sa.Float, nullable=False),
        sa.Column("down", sa.JSON()),
    )


def downgrade() -> None:
    """Drop the tables."""
    op.drop_table("recording_frames")
    op.drop_table("recordings")
