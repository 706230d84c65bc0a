"""A running build names its worker, whose heartbeat is counted in the row."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns. What ran under the release before has no worker, and is queued again."""
    op.add_column("builds", sa.Column("worker", sa.String(200)))
    op.add_column("builds", sa.Column("heartbeat", sa.Integer(), nullable=False, server_default="0"))


def downgrade() -> None:
    """Remove the columns."""
    op.drop_column("builds", "heartbeat")
    op.drop_column("builds", "worker")
