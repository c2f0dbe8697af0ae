"""Signed heads of the audit log, and the signature of an uplink package."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None

ANCHORS = "audit_anchors"
TEXTS = ("head", "at_utc", "made_by", "public_key", "signature")
LATER = ("time_stamp", "stamped_utc", "hash", "outcome_hash")


def upgrade() -> None:
    """Add the table and the column; packages that were built before have no signature."""
    op.create_table(
        ANCHORS,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("record_id", sa.Integer(), nullable=False),
        *(sa.Column(name, sa.Text(), nullable=False) for name in TEXTS),
        *(sa.Column(name, sa.Text(), nullable=True) for name in LATER),
        sqlite_strict=True,
    )
    op.add_column("packages", sa.Column("signature", sa.Text(), nullable=True))


def downgrade() -> None:
    """Take both away; the log stays, and the ZIP files keep their signatures."""
    op.drop_column("packages", "signature")
    op.drop_table(ANCHORS)
