"""Schedules of backups and the backups taken by them, with a kind of alarm for one that failed or is missing; removed telemetry.

No schedule and no backup is removed, and what was scheduled never changes. The way back leaves the longer list of kinds: alarms of
the new kind may be there, and are records.
"""

from __future__ import annotations

import re

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None

KINDS = "'DRIFT', 'AGE', 'MISMATCH', 'CHAIN', 'FILES', 'HEAD', 'CLOCK', 'INGEST', 'LINK', 'BACKUP'"
STATES = "'RUNNING', 'TESTING', 'SUCCEEDED', 'FAILED'"
NUMBERS = ("at_minute", "every_hours", "keep_daily", "keep_weekly", "keep_monthly")
FIXED = {
    "backup_schedules": ("destination", *NUMBERS, "created_utc", "created_by"),
    "backups": ("schedule_id", "due_utc"),
}
REMOVED = ("telemetry_sets", "blobs")
LATER = ("lease_until_utc", "written_utc", "ended_utc", "sentence")


def upgrade() -> None:
    """Add the tables and their guards, and let alarms be of the new kind."""
    op.create_table(
        "backup_schedules",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("destination", sa.Text(), nullable=False),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in NUMBERS),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.Column("created_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sqlite_strict=True,
    )
    op.create_table(
        "backups",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("schedule_id", sa.Integer(), sa.ForeignKey("backup_schedules.id"), nullable=False),
        sa.Column("due_utc", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("started_utc", sa.Text(), nullable=False),
        *(sa.Column(name, sa.Text(), nullable=True) for name in LATER),
        sa.Column("size_bytes", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=True),
        sa.Column("key_id", sa.Text(), nullable=True),
        sa.Column("files", sa.Integer(), nullable=True),
        *(sa.Column(name, sa.Text(), nullable=True) for name in ("head", "tested_utc", "removed_utc")),
        sa.CheckConstraint(f"state IN ({STATES})", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_backups_state_id", "backups", ["state", "id"])
    for table in REMOVED:
        op.add_column(table, sa.Column("removed_utc", sa.Text(), nullable=True))
    for table, fixed in FIXED.items():
        _guard(table, fixed)
    _widen_kinds()


def downgrade() -> None:
    """Take tables and columns away; the files of the backups stay where they are, and removed telemetry counts as missing."""
    for table in REMOVED:
        op.drop_column(table, "removed_utc")
    op.drop_table("backups")
    op.drop_table("backup_schedules")


def _is_postgresql() -> bool:
    return bool(op.get_bind().dialect.name == "postgresql")


def _guard(table: str, fixed: tuple[str, ...]) -> None:
    """Refuse to remove a row of a table, and to change what it says."""
    differs = "IS DISTINCT FROM" if _is_postgresql() else "IS NOT"
    moved = " OR ".join(f"NEW.{name} {differs} OLD.{name}" for name in fixed)
    for kind, statement, what, when in (
        ("removal", "DELETE", f"a row of {table}", ""),
        ("change", "UPDATE", f"what a row of {table} says", f"WHEN ({moved}) "),
    ):
        past = "changed" if kind == "change" else "removed"
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
        if _is_postgresql():
            body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
            if kind == "removal":
                truncation = f"{table}_no_truncation BEFORE TRUNCATE ON {table}"
                op.execute(f"CREATE TRIGGER {truncation} FOR EACH STATEMENT {body}")
        op.execute(f"CREATE TRIGGER {table}_no_{kind} BEFORE {statement} ON {table} FOR EACH ROW {when}{body}")


def _widen_kinds() -> None:
    """Let alarms be of one more kind."""
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
