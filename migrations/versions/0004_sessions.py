"""Sessions and where they went."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the tables."""
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("camera", sa.JSON()),
        sa.Column("destination", sa.String(200)),
        sa.Column("language", sa.String(35)),
        sa.Column("memory", sa.JSON(), nullable=False),
        sa.Column("frames", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("active_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["venue_id"], ["venues.id"], name="fk_sessions_venue_id", ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name="pk_sessions"),
    )
    op.create_index("ix_sessions_venue_id", "sessions", ["venue_id"])
    op.create_index("ix_sessions_active_at", "sessions", ["active_at"])
    op.create_table(
        "session_points",
        sa.Column("session_id", sa.String(32), nullable=False),
        sa.Column("frame", sa.Integer(), nullable=False),
        sa.Column("time_s", sa.Float(), nullable=False),
        sa.Column("tracking", sa.String(16), nullable=False),
        sa.Column("pose", sa.JSON()),
        sa.Column("floor", sa.String(64)),
        sa.Column("plan", sa.JSON()),
        sa.Column("position_m", sa.Float()),
        sa.ForeignKeyConstraint(
            ["session_id"], ["sessions.id"], name="fk_session_points_session_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("session_id", "frame", name="pk_session_points"),
    )


def downgrade() -> None:
    """Drop the tables."""
    for table in ("session_points", "sessions"):
        op.drop_table(table)
