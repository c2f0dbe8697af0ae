"""Addresses at which people get messages, the messages, and the trace that a run belongs to."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables, and the column."""
    op.add_column("runs", sa.Column("traceparent", sa.Text(), nullable=True))
    op.create_table(
        "message_addresses",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        *(
            sa.Column(name, sa.Text(), nullable=name in {"quiet_from", "quiet_until", "removed_utc"})
            for name in (
                "label",
                "service",
                "shown",
                "address",
                "kinds",
                "quiet_from",
                "quiet_until",
                "quiet_zone",
                "created_utc",
                "removed_utc",
            )
        ),
        sa.Column("told_audit_id", sa.Integer(), nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_message_addresses_user_id", "message_addresses", ["user_id"])
    op.create_table(
        "messages",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("address_id", sa.Integer(), sa.ForeignKey("message_addresses.id"), nullable=False),
        sa.Column("audit_id", sa.Integer(), nullable=True),
        *(sa.Column(name, sa.Text(), nullable=False) for name in ("kind", "subject", "text", "path", "state")),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("due_utc", sa.Text(), nullable=False),
        sa.Column("attempted_utc", sa.Text(), nullable=True),
        sa.Column("outcome", sa.Text(), nullable=True),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.CheckConstraint("state IN ('PENDING', 'DELIVERED', 'FAILED', 'DROPPED')", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_messages_state_due_utc", "messages", ["state", "due_utc"])
    op.create_index("ix_messages_address_id_id", "messages", ["address_id", "id"])


def downgrade() -> None:
    """Take the tables away; nobody gets messages then, and no run knows its trace."""
    op.drop_table("messages")
    op.drop_table("message_addresses")
    op.drop_column("runs", "traceparent")
