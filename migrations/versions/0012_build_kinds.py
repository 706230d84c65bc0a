"""A build has a kind, by which workers choose, and a priority."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns. What was queued by the release before counts as a scan."""
    op.add_column("builds", sa.Column("kind", sa.String(16), nullable=False, server_default="scan"))
    op.add_column("builds", sa.Column("priority", sa.Integer(), nullable=False, server_default="0"))


def downgrade() -> None:
    """Remove the columns."""
    op.drop_column("builds", "priority")
    op.drop_column("builds", "kind")
