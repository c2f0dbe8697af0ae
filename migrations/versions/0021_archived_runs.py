"""Runs that lists do not show; a table of its own, for the row of a run that has ended is never changed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "archived_runs",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("runs.id"), nullable=False, unique=True),
        sa.Column("archived_utc", sa.Text(), nullable=False),
        sqlite_strict=True,
    )


def downgrade() -> None:
    """Take it away: lists show every run again."""
    op.drop_table("archived_runs")
