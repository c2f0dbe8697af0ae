"""Log-ins are rows of the store, so that each can be seen and ended.

A cookie of before is no log-in any more: people log in again.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

ENDINGS = "'logged_out', 'ended', 'ended_by_administrator', 'password_changed', 'roles_changed', 'disabled', 'idle', 'expired'"


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "login_sessions",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("token_hash", sa.Text(), nullable=False, unique=True),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.Column("last_used_utc", sa.Text(), nullable=False),
        sa.Column("ended_utc", sa.Text()),
        sa.Column("ended_because", sa.Text()),
        sa.Column("address", sa.Text(), nullable=False),
        sa.Column("user_agent", sa.Text(), nullable=False),
        sa.CheckConstraint(f"ended_because IN ({ENDINGS})", name="ended_because"),
        sqlite_strict=True,
    )
    op.create_index("ix_login_sessions_user_id_ended_utc", "login_sessions", ["user_id", "ended_utc"])
    op.create_index("ix_login_sessions_ended_utc", "login_sessions", ["ended_utc"])


def downgrade() -> None:
    """Take it away again; everybody logs in again."""
    op.drop_table("login_sessions")
