"""A map version keeps small pictures of the frames that its build left out."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the table; versions that are stored already have no such pictures."""
    op.create_table(
        "left_out_frames",
        sa.Column("venue_id", sa.String(64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("reason", sa.String(32), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("time_s", sa.Float()),
        sa.Column("picture_blob", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("venue_id", "version", "number", name="pk_left_out_frames"),
        sa.ForeignKeyConstraint(
            ["venue_id", "version"],
            ["map_versions.venue_id", "map_versions.version"],
            name="fk_left_out_frames_venue_id",
            ondelete="CASCADE",
        ),
    )


def downgrade() -> None:
    """Remove the table; the blobs are swept."""
    op.drop_table("left_out_frames")
