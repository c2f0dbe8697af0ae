"""Records on board say whether the update of C_SD was loaded with a set that turns the attitude; earlier ones are not told."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None

TABLE, COLUMNS = "uplinks", ("c_sd", "c_sd_said")


def upgrade() -> None:
    """Add the answer and what was said with it; without a list of its words, for which SQLite would copy the table."""
    for name in COLUMNS:
        op.add_column(TABLE, sa.Column(name, sa.Text(), nullable=True))


def downgrade() -> None:
    """Take both away; the audit log keeps what was recorded."""
    for name in COLUMNS:
        op.drop_column(TABLE, name)
