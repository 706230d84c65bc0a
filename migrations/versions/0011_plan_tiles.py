"""A plan of many pixels has tiles: the blob that holds them, and how they are cut."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; plans that are stored already have no tiles until they are sent again."""
    op.add_column("floors", sa.Column("plan_tiles_blob", sa.String(64)))
    op.add_column("floors", sa.Column("plan_tiles", sa.JSON()))


def downgrade() -> None:
    """Remove the columns; the blobs are swept."""
    op.drop_column("floors", "plan_tiles")
    op.drop_column("floors", "plan_tiles_blob")
