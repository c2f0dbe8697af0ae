"""Records on board say whether the update of C_SD was loaded with a set that turns the attitude; earlier ones are not told."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None

TABLE, COLUMNS = "uplinks", (("c_sd", sa.Text), ("c_sd_said", sa.Text), ("leaves_state", sa.Integer))


def upgrade() -> None:
    """Add the answer, what was said with it, and whether the record is about it alone; null for what was recorded before.

    Without a list of its words, for which SQLite would copy the table.
    """
    for name, kind in COLUMNS:
        op.add_column(TABLE, sa.Column(name, kind(), nullable=True))


def downgrade() -> None:
    """Take them away, and the records that are about C_SD alone, which would become steps; the audit log keeps what they said."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute(f"ALTER TABLE {TABLE} DISABLE TRIGGER USER")
        _remove_records()
        op.execute(f"ALTER TABLE {TABLE} ENABLE TRIGGER USER")
    else:
        query = sa.text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = :table")
        guards = op.get_bind().execute(query, {"table": TABLE}).fetchall()
        for name, _ in guards:
            op.execute(f"DROP TRIGGER {name}")
        _remove_records()
        for _, statement in guards:
            op.execute(sa.text(statement.replace(":", r"\:")))
    for name, _ in COLUMNS:
        op.drop_column(TABLE, name)


def _remove_records() -> None:
    table = sa.table(TABLE, sa.column("leaves_state"))
    op.execute(sa.delete(table).where(table.c.leaves_state.is_not(None)))
