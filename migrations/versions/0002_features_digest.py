"""The digest of a floor's features, so that what was made of them can be kept in memory."""

import hashlib
import json

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column and fill it."""
    op.add_column("floors", sa.Column("features_sha256", sa.String(64)))
    floors = sa.table(
        "floors",
        sa.column("venue_id", sa.String),
        sa.column("id", sa.String),
        sa.column("features", sa.JSON),
        sa.column("features_sha256", sa.String),
    )
    connection = op.get_bind()
    for row in connection.execute(sa.select(floors)).all():
        if row.features is not None:
            digest = hashlib.sha256(json.dumps(row.features, sort_keys=True).encode()).hexdigest()
            here = (floors.c.venue_id == row.venue_id) & (floors.c.id == row.id)
            connection.execute(sa.update(floors).where(here).values(features_sha256=digest))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("floors", "features_sha256")
