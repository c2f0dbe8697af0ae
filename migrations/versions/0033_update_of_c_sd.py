"""Records on board say whether the update of C_SD was loaded with a set that turns the attitude; earlier ones are not told."""

from __future__ import annotations

from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None

TABLE = "uplinks"
ANSWER = "c_sd TEXT CONSTRAINT ck_uplinks_c_sd CHECK (c_sd IN ('LOADED', 'NOT YET', 'NOT NEEDED'))"


def upgrade() -> None:
    """Add the answer, with the words that it may have, and what was said with it."""
    for column in (ANSWER, "c_sd_said TEXT"):
        op.execute(f"ALTER TABLE {TABLE} ADD COLUMN {column}")


def downgrade() -> None:
    """Take both away; the audit log keeps what was recorded."""
    for column in ("c_sd_said", "c_sd"):
        op.drop_column(TABLE, column)
