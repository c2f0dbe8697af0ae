"""Links to mission control systems: how far telemetry was pulled for a sensor, and which audit records are events there already.

Decisions may come of an archive, and alarms may be of a link that fails. The way back leaves the longer lists of words: rows
that have the new ones may be there, and are records.
"""

from __future__ import annotations

import re

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None

LINKS = "mission_control_links"
WORDS = (
    ("alarms", "kind", "'DRIFT', 'AGE', 'MISMATCH', 'CHAIN', 'FILES', 'HEAD', 'CLOCK', 'INGEST', 'LINK'"),
    ("ingest_decisions", "source", "'FOLDER', 'REST', 'ARCHIVE'"),
)


def upgrade() -> None:
    """Add the table, and let decisions and alarms have the new words."""
    op.create_table(
        LINKS,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("system", sa.Text(), nullable=False),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=True),
        sa.Column("begins_utc", sa.Text(), nullable=False),
        sa.Column("asked_to_utc", sa.Text(), nullable=False),
        sa.Column("taken", sa.LargeBinary(), nullable=False),
        sa.Column("told_audit_id", sa.Integer(), nullable=False),
        sa.Column("due_utc", sa.Text(), nullable=False),
        sa.Column("succeeded_utc", sa.Text(), nullable=True),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.Column("fault", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.CheckConstraint("system IN ('yamcs', 'openc3')", name="system"),
        sqlite_strict=True,
    )
    for name, column, where in (
        ("uq_mission_control_links_one_a_sensor", "sensor_id", "sensor_id IS NOT NULL"),
        ("uq_mission_control_links_one_of_events", "system", "sensor_id IS NULL"),
    ):
        op.create_index(
            name, LINKS, [column], unique=True, sqlite_where=sa.text(where), postgresql_where=sa.text(where)
        )
    for table, column, words in WORDS:
        _widen(table, column, words)


def downgrade() -> None:
    """Take the table away."""
    op.drop_table(LINKS)


def _widen(table: str, column: str, words: str) -> None:
    """Let a column hold more words; what stands on the table is made again with it."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute(f"ALTER TABLE {table} DROP CONSTRAINT ck_{table}_{column}")
        op.execute(f"ALTER TABLE {table} ADD CONSTRAINT ck_{table}_{column} CHECK ({column} IN ({words}))")
        return
    made = op.get_bind().exec_driver_sql(
        f"SELECT type, sql FROM sqlite_master WHERE tbl_name = '{table}' AND sql IS NOT NULL"  # noqa: S608 - one of `WORDS`
    )
    found = made.fetchall()
    (statement,) = (sql for kind, sql in found if kind == "table")
    statement = re.sub(rf'^CREATE TABLE "?{table}"?', f"CREATE TABLE {table}_new", statement)
    op.execute(sa.text(re.sub(rf"\b{column} IN \([^)]*\)", f"{column} IN ({words})", statement).replace(":", r"\:")))
    op.execute(f"INSERT INTO {table}_new SELECT * FROM {table}")  # noqa: S608 - one of `WORDS`
    op.execute(f"DROP TABLE {table}")
    op.execute(f"ALTER TABLE {table}_new RENAME TO {table}")
    for kind, sql in found:
        if kind != "table":
            op.execute(sa.text(sql.replace(":", r"\:")))
