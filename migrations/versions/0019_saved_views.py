"""Views of pages that people saved under a name."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "saved_views",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("favourite", sa.Integer(), nullable=False),
        sa.Column("shared", sa.Integer(), nullable=False),
        sa.Column("made_utc", sa.Text(), nullable=False),
        sa.UniqueConstraint("user_id", "path"),
        sqlite_strict=True,
    )


def downgrade() -> None:
    """Take it away; addresses that were copied still lead where they led."""
    op.drop_table("saved_views")
