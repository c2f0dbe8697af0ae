"""Hashes for the log of runs and for webhooks' messages, so that an edit or a removal by hand is told; three more kinds of alarm.

Each line that is there is chained to the one before as it stands: from now on any edit shows, what was edited before does not.
The way back leaves the longer list of kinds: alarms of the new kinds may be there, and are records.
"""

from __future__ import annotations

import hashlib
import json
import re

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

FIRST_HASH = "0" * 64
JOURNALS = {
    "run_events": ("id", "run_id", "attempt", "at_utc", "kind", "message"),
    "webhook_deliveries": ("id", "webhook_id", "audit_id", "body", "created_utc"),
}
OUTCOME = ("state", "attempts", "attempted_utc", "status", "outcome")
KINDS = "'DRIFT', 'AGE', 'MISMATCH', 'CHAIN', 'FILES', 'HEAD', 'CLOCK'"
ROWS = 1000


def upgrade() -> None:
    """Add the columns, fill them, and let alarms be of the installation's files, kept head and clock."""
    for table in JOURNALS:
        op.add_column(table, sa.Column("hash", sa.Text(), nullable=True))
    op.add_column("webhook_deliveries", sa.Column("outcome_hash", sa.Text(), nullable=True))
    for table, columns in JOURNALS.items():
        _chain(table, columns)
    _widen_kinds()


def downgrade() -> None:
    """Take the columns away; PostgreSQL numbers the lines itself again."""
    op.drop_column("webhook_deliveries", "outcome_hash")
    for table in JOURNALS:
        op.drop_column(table, "hash")
        if _is_postgresql():
            op.execute(
                f"SELECT setval(pg_get_serial_sequence('{table}', 'id'), coalesce(max(id), 0) + 1, false) FROM {table}"  # noqa: S608 - names of our own
            )


def _is_postgresql() -> bool:
    return bool(op.get_bind().dialect.name == "postgresql")


def _chain(name: str, columns: tuple[str, ...]) -> None:
    """Chain the rows that are there, in the order of their keys."""
    table = sa.table(name, *(sa.column(column) for column in (*columns, *OUTCOME, "hash", "outcome_hash")))
    moving = OUTCOME if name == "webhook_deliveries" else ()
    wanted = [table.c[column] for column in (*columns, *moving)]
    previous, last_id = FIRST_HASH, 0
    while True:
        query = sa.select(*wanted).where(table.c.id > last_id).order_by(table.c.id).limit(ROWS)
        rows = op.get_bind().execute(query).mappings().all()
        if not rows:
            return
        for row in rows:
            previous, last_id = _hash(previous, {column: row[column] for column in columns}), row["id"]
            written = {"hash": previous}
            if moving:
                written["outcome_hash"] = _hash(previous, {column: row[column] for column in moving})
            op.get_bind().execute(sa.update(table).where(table.c.id == last_id).values(**written))


def _hash(previous: str, row: dict[str, object]) -> str:
    """Hash a row after the one before."""
    kept = {name: value for name, value in row.items() if value is not None}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(f"{previous}{text}".encode()).hexdigest()


def _widen_kinds() -> None:
    """Let alarms be of more kinds."""
    if _is_postgresql():
        op.execute("ALTER TABLE alarms DROP CONSTRAINT ck_alarms_kind")
        op.execute(f"ALTER TABLE alarms ADD CONSTRAINT ck_alarms_kind CHECK (kind IN ({KINDS}))")
        return
    made = op.get_bind().exec_driver_sql(
        "SELECT type, sql FROM sqlite_master WHERE tbl_name = 'alarms' AND sql IS NOT NULL"
    )
    found = made.fetchall()
    (table,) = (sql for kind, sql in found if kind == "table")
    table = re.sub(r'^CREATE TABLE "?alarms"?', "CREATE TABLE alarms_new", table)
    op.execute(re.sub(r"kind IN \([^)]*\)", f"kind IN ({KINDS})", table))
    op.execute("INSERT INTO alarms_new SELECT * FROM alarms")
    op.execute("DROP TABLE alarms")
    op.execute("ALTER TABLE alarms_new RENAME TO alarms")
    for kind, sql in found:  # what stood on the table went with it
        if kind != "table":
            op.execute(sa.text(sql.replace(":", r"\:")))
