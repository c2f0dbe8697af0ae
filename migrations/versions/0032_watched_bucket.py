"""Versions of objects in the watched bucket that were taken. Decisions may come of it.

The way back leaves the longer list of words: rows that have the new one may be there, and are records.
"""

from __future__ import annotations

import re

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"
branch_labels = None
depends_on = None

TABLE, DECISIONS = "taken_objects", "ingest_decisions"
WORDS = "'FOLDER', 'REST', 'ARCHIVE', 'BUCKET'"


def upgrade() -> None:
    """Add the table, and let decisions have the new source."""
    op.create_table(
        TABLE,
        sa.Column("id", sa.Integer(), primary_key=True),
        *(sa.Column(name, sa.Text(), nullable=False) for name in ("address", "version", "taken_utc")),
        sa.UniqueConstraint("address", "version"),
        sqlite_strict=True,
    )
    if op.get_bind().dialect.name == "postgresql":
        op.execute(f"ALTER TABLE {DECISIONS} DROP CONSTRAINT ck_{DECISIONS}_source")
        op.execute(f"ALTER TABLE {DECISIONS} ADD CONSTRAINT ck_{DECISIONS}_source CHECK (source IN ({WORDS}))")
    else:
        _make_again()


def downgrade() -> None:
    """Take the table away."""
    op.drop_table(TABLE)


def _make_again() -> None:
    """Make SQLite's table of decisions again with the longer list, and what stands on it."""
    made = op.get_bind().exec_driver_sql(
        f"SELECT type, sql FROM sqlite_master WHERE tbl_name = '{DECISIONS}' AND sql IS NOT NULL"  # noqa: S608 - a constant
    )
    found = made.fetchall()
    (statement,) = (sql for kind, sql in found if kind == "table")
    statement = re.sub(rf'^CREATE TABLE "?{DECISIONS}"?', f"CREATE TABLE {DECISIONS}_new", statement)
    op.execute(sa.text(re.sub(r"\bsource IN \([^)]*\)", f"source IN ({WORDS})", statement).replace(":", r"\:")))
    op.execute(f"INSERT INTO {DECISIONS}_new SELECT * FROM {DECISIONS}")  # noqa: S608 - a constant
    op.execute(f"DROP TABLE {DECISIONS}")
    op.execute(f"ALTER TABLE {DECISIONS}_new RENAME TO {DECISIONS}")
    for kind, sql in found:
        if kind != "table":
            op.execute(sa.text(sql.replace(":", r"\:")))
