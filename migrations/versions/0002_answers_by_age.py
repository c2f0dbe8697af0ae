"""Find the answers kept for Idempotency-Keys by their age, for they are deleted after a day."""

from __future__ import annotations

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

INDEX = "ix_idempotent_responses_created_utc"


def upgrade() -> None:
    """Make the index."""
    op.create_index(INDEX, "idempotent_responses", ["created_utc"])


def downgrade() -> None:
    """Drop the index."""
    op.drop_index(INDEX, "idempotent_responses")
