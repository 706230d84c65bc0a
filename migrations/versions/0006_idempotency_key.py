"""Builds remember the key that a client submitted them with."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column."""
    op.add_column("builds", sa.Column("idempotency_key", sa.String(64)))
    op.create_index("ix_builds_idempotency_key", "builds", ["venue_id", "idempotency_key"], unique=True)


def downgrade() -> None:
    """Drop the column."""
    op.drop_index("ix_builds_idempotency_key", "builds")
    with op.batch_alter_table("builds") as batch:
        batch.drop_column("idempotency_key")
