"""A venue may have a place on Earth."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column."""
    op.add_column("venues", sa.Column("origin", sa.JSON()))


def downgrade() -> None:
    """Remove the column."""
    op.drop_column("venues", "origin")
