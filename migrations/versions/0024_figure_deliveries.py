"""Which figure of a request the server gave to whom; it counts as opened only once it stood in their sight."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "figure_deliveries",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("approval_id", sa.Integer(), sa.ForeignKey("approvals.id"), nullable=False),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("evidence", sa.Text(), nullable=False),
        sa.Column("given_utc", sa.Text(), nullable=False),
        sa.UniqueConstraint("approval_id", "user_id", "evidence"),
        sqlite_strict=True,
    )


def downgrade() -> None:
    """Take it away: a figure then counts as opened when it is given."""
    op.drop_table("figure_deliveries")
