"""Policies for new telemetry and the decisions made by them, with a kind of alarm for a policy that was stopped.

What a policy says never changes, nor what a decision is about; no policy and no decision is removed. The way back leaves the longer
list of kinds: alarms of the new kind may be there, and are records.
"""

from __future__ import annotations

import re

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None

KINDS = "'DRIFT', 'AGE', 'MISMATCH', 'CHAIN', 'FILES', 'HEAD', 'CLOCK', 'INGEST'"
POLICY_STATES = "'DRAFT', 'ACTIVE', 'PAUSED', 'OFF'"
PAUSE_CODES = "'TOO MANY SETS', 'TOO MANY REQUESTS', 'BAD CLOCK', 'WRONG SENSOR', 'FAILURES', 'FOLDER', 'PERSON'"
DECISION_STATES = (
    "'CALIBRATING', 'WITHIN FORECAST', 'UNCONFIRMED', 'ASKED', 'ANSWERED', 'SUPERSEDED', 'NOT JUDGED', 'REFUSED'"
)
ANSWERS = "'SUBMIT', 'WAIT', 'MORE DATA', 'RECALIBRATE'"
FIXED = {
    "ingest_policies": ("sensor_id", "number", "document", "sha256", "reason", "created_utc", "created_by"),
    "ingest_decisions": (
        "sensor_id",
        "policy_id",
        "source",
        "file_name",
        "file_sha256",
        "size_bytes",
        "received_utc",
        "received_by",
        "telemetry_set_id",
    ),
}


def upgrade() -> None:
    """Add the tables and their guards, and let alarms be of the new kind."""
    _add_policies()
    _add_decisions()
    for table, fixed in FIXED.items():
        _guard(table, fixed)
    _widen_kinds()


def downgrade() -> None:
    """Take the tables away, their guards with them."""
    op.drop_table("ingest_decisions")
    op.drop_table("ingest_policies")


def _add_policies() -> None:
    op.create_table(
        "ingest_policies",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.Column("created_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("rehearsal", sa.Text(), nullable=True),
        sa.Column("rehearsed_utc", sa.Text(), nullable=True),
        sa.Column("enabled_utc", sa.Text(), nullable=True),
        sa.Column("pause_code", sa.Text(), nullable=True),
        sa.Column("pause_reason", sa.Text(), nullable=True),
        sa.Column("paused_utc", sa.Text(), nullable=True),
        sa.Column("resumed_utc", sa.Text(), nullable=True),
        sa.CheckConstraint(f"state IN ({POLICY_STATES})", name="state"),
        sa.CheckConstraint(f"pause_code IN ({PAUSE_CODES})", name="pause_code"),
        sa.UniqueConstraint("sensor_id", "number"),
        sqlite_strict=True,
    )
    in_force = sa.text("state IN ('ACTIVE', 'PAUSED')")
    op.create_index(
        "uq_ingest_policies_one_in_force",
        "ingest_policies",
        ["sensor_id"],
        unique=True,
        sqlite_where=in_force,
        postgresql_where=in_force,
    )


def _add_decisions() -> None:
    op.create_table(
        "ingest_decisions",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=False),
        sa.Column("policy_id", sa.Integer(), sa.ForeignKey("ingest_policies.id"), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("file_name", sa.Text(), nullable=False),
        sa.Column("file_sha256", sa.Text(), nullable=True),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("received_utc", sa.Text(), nullable=False),
        sa.Column("received_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("telemetry_set_id", sa.Integer(), sa.ForeignKey("telemetry_sets.id"), nullable=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("runs.id"), nullable=True),
        sa.Column("parameter_set_id", sa.Integer(), sa.ForeignKey("parameter_sets.id"), nullable=True),
        sa.Column("approval_id", sa.Integer(), sa.ForeignKey("approvals.id"), nullable=True),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("sentence", sa.Text(), nullable=False),
        sa.Column("evidence", sa.Text(), nullable=False),
        sa.Column("decided_utc", sa.Text(), nullable=True),
        sa.Column("answer", sa.Text(), nullable=True),
        sa.Column("answer_reason", sa.Text(), nullable=True),
        sa.Column("answered_utc", sa.Text(), nullable=True),
        sa.Column("answered_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("quiet_until_utc", sa.Text(), nullable=True),
        sa.CheckConstraint(f"state IN ({DECISION_STATES})", name="state"),
        sa.CheckConstraint("source IN ('FOLDER', 'REST')", name="source"),
        sa.CheckConstraint(f"answer IN ({ANSWERS})", name="answer"),
        sqlite_strict=True,
    )
    op.create_index("ix_ingest_decisions_sensor_id_id", "ingest_decisions", ["sensor_id", "id"])
    op.create_index("ix_ingest_decisions_state", "ingest_decisions", ["state"])
    for column in ("file_sha256", "run_id"):
        op.create_index(f"ix_ingest_decisions_{column}", "ingest_decisions", [column])
    asked = sa.text("state = 'ASKED'")
    op.create_index(
        "uq_ingest_decisions_one_asked",
        "ingest_decisions",
        ["sensor_id"],
        unique=True,
        sqlite_where=asked,
        postgresql_where=asked,
    )


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
