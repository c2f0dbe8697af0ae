"""A promotion keeps why it was made."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; of what was promoted before, the reason is that of its request."""
    op.add_column("promotions", sa.Column("reason", sa.Text()))


def downgrade() -> None:
    """Take the column away; the audit log has what it said."""
    op.drop_column("promotions", "reason")
