"""Every table, index and trigger of the first release.

The triggers say in the database what the services say in Python, for whoever edits by hand: the audit log, signatures,
uplinks and promotions are only ever added to; a run that has ended stays as it ended; a parameter set's document never
changes. A later revision that rebuilds one of these tables in batch mode must make its triggers again.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

RUN_STATES = "'QUEUED', 'RUNNING', 'CANCELLING', 'SUCCEEDED', 'FAILED', 'CANCELLED', 'LOST'"
TERMINAL_RUN_STATES = "'SUCCEEDED', 'FAILED', 'CANCELLED', 'LOST'"
GROUND_STATES = "'CANDIDATE', 'SUBMITTED', 'APPROVED', 'BASELINE', 'SUPERSEDED', 'REJECTED', 'WITHDRAWN', 'EXPIRED'"
ONBOARD_STATES = "'NOT SENT', 'SENT', 'LOADED', 'VERIFIED', 'ACTIVE', 'MISMATCH', 'UNKNOWN'"
APPROVAL_STATES = "'OPEN', 'APPROVED', 'REJECTED', 'WITHDRAWN', 'STALE', 'EXPIRED'"

APPEND_ONLY = ("audit", "signatures", "uplinks", "promotions")
END_OF_RUN = (f"OLD.state IN ({TERMINAL_RUN_STATES})", ("state", "result_sha256", "attempt"))
BODY_OF_SET = ("", ("document", "sha256", "name", "number", "sensor_id", "run_id"))


def _key() -> sa.Column:
    return sa.Column("id", sa.Integer(), primary_key=True)


def _text(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Text(), nullable=nullable)


def _number(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Integer(), nullable=nullable)


def _refers(name: str, table: str, *, nullable: bool = False) -> sa.Column:
    """Refer to a row by its id."""
    kind = sa.Text() if table == "blobs" else sa.Integer()
    target = "blobs.sha256" if table == "blobs" else f"{table}.id"
    return sa.Column(name, kind, sa.ForeignKey(target), nullable=nullable)


def _one_of(column: str, words: str) -> sa.CheckConstraint:
    return sa.CheckConstraint(f"{column} IN ({words})", name=column)


def _table(name: str, *parts: sa.Column | sa.Constraint) -> None:
    op.create_table(name, *parts, sqlite_strict=True)


def _one_only(name: str, table: str, column: str, where: str) -> None:
    """Allow one row for each value of a column among the rows that meet a condition."""
    condition = sa.text(where)
    op.create_index(name, table, [column], unique=True, sqlite_where=condition, postgresql_where=condition)


def upgrade() -> None:
    """Make everything, what is referred to first."""
    _people()
    _fleet()
    _runs()
    _parameter_sets()
    _records()
    _guards()


def downgrade() -> None:
    """Remove everything, what refers first; triggers go with their tables."""
    for table in ("idempotent_responses", "audit", "promotions", "uplinks", "signatures", "approvals"):
        op.drop_table(table)
    for table in ("parameter_sets", "run_events", "runs", "telemetry_sets", "blobs", "sensors"):
        op.drop_table(table)
    for table in ("login_failures", "api_keys", "users"):
        op.drop_table(table)
    if op.get_bind().dialect.name == "postgresql":
        for function in ("refuse_change", "refuse_removal"):
            op.execute(f"DROP FUNCTION {function}()")


def _people() -> None:
    _table(
        "users",
        _key(),
        sa.Column("name", sa.Text(), nullable=False, unique=True),
        _text("printed_name"),
        _text("password_hash"),
        _text("roles"),
        _text("created_utc"),
        _text("disabled_utc", nullable=True),
        _number("session_epoch"),
    )
    _table(
        "api_keys",
        _key(),
        _refers("user_id", "users"),
        _text("label"),
        sa.Column("prefix", sa.Text(), nullable=False, unique=True),
        _text("key_hash"),
        _text("scopes"),
        _text("created_utc"),
        _text("expires_utc", nullable=True),
        _text("revoked_utc", nullable=True),
    )
    _table("login_failures", _key(), _text("name"), _text("at_utc"))
    op.create_index("ix_login_failures_name_at_utc", "login_failures", ["name", "at_utc"])


def _fleet() -> None:
    _table(
        "sensors",
        _key(),
        sa.Column("name", sa.Text(), nullable=False, unique=True),
        _text("document"),
        _number("version"),
        _text("created_utc"),
        _refers("created_by", "users", nullable=True),
        _number("simulated"),
        _text("truth", nullable=True),
    )
    _table(
        "blobs",
        sa.Column("sha256", sa.Text(), primary_key=True),
        sa.Column("size_bytes", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        _text("media_type"),
        _text("created_utc"),
    )
    _table(
        "telemetry_sets",
        _key(),
        _refers("sensor_id", "sensors"),
        _text("name"),
        _text("purpose"),
        _refers("original_sha256", "blobs"),
        _refers("table_sha256", "blobs"),
        _number("frames"),
        _number("stars"),
        _text("quality"),
        _text("uploaded_utc"),
        _refers("uploaded_by", "users", nullable=True),
        _text("archived_utc", nullable=True),
        sa.UniqueConstraint("sensor_id", "original_sha256"),
    )
    op.create_index("ix_telemetry_sets_sensor_id", "telemetry_sets", ["sensor_id"])


def _runs() -> None:
    _table(
        "runs",
        _key(),
        _refers("sensor_id", "sensors"),
        _refers("telemetry_set_id", "telemetry_sets"),
        _refers("validation_set_id", "telemetry_sets", nullable=True),
        _text("method"),
        _text("settings"),
        _text("sensor_document"),
        _text("label"),
        _text("state"),
        _text("reason", nullable=True),
        _number("attempt"),
        _text("owner", nullable=True),
        _text("lease_until_utc", nullable=True),
        _number("cancel_requested"),
        _text("launched_utc"),
        _refers("launched_by", "users", nullable=True),
        _text("started_utc", nullable=True),
        _text("ended_utc", nullable=True),
        _text("progress", nullable=True),
        _refers("result_sha256", "blobs", nullable=True),
        _text("summary", nullable=True),
        _one_of("state", RUN_STATES),
    )
    op.create_index("ix_runs_sensor_id", "runs", ["sensor_id"])
    op.create_index("ix_runs_state_id", "runs", ["state", "id"])
    _table(
        "run_events",
        _key(),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("runs.id", ondelete="CASCADE"), nullable=False),
        _number("attempt"),
        _text("at_utc"),
        _text("kind"),
        _text("message"),
    )
    op.create_index("ix_run_events_run_id", "run_events", ["run_id"])


def _parameter_sets() -> None:
    _table(
        "parameter_sets",
        _key(),
        sa.Column("name", sa.Text(), nullable=False, unique=True),
        _refers("sensor_id", "sensors"),
        _number("number"),
        _refers("run_id", "runs", nullable=True),
        _text("sha256"),
        _text("document"),
        _text("ground_state"),
        _text("onboard_state"),
        _number("version"),
        _text("created_utc"),
        _refers("created_by", "users", nullable=True),
        _text("baseline_from_utc", nullable=True),
        _text("baseline_to_utc", nullable=True),
        _one_of("ground_state", GROUND_STATES),
        _one_of("onboard_state", ONBOARD_STATES),
        sa.UniqueConstraint("sensor_id", "number"),
    )
    op.create_index("ix_parameter_sets_sensor_id", "parameter_sets", ["sensor_id"])
    _one_only("uq_parameter_sets_one_baseline", "parameter_sets", "sensor_id", "ground_state = 'BASELINE'")
    _one_only("uq_parameter_sets_one_active", "parameter_sets", "sensor_id", "onboard_state = 'ACTIVE'")
    _table(
        "approvals",
        _key(),
        _refers("parameter_set_id", "parameter_sets"),
        _text("state"),
        _text("reason"),
        _text("submitted_utc"),
        _refers("submitted_by", "users"),
        _text("bound"),
        _number("version"),
        _text("closed_utc", nullable=True),
        _one_of("state", APPROVAL_STATES),
    )
    op.create_index("ix_approvals_parameter_set_id", "approvals", ["parameter_set_id"])
    _one_only("uq_approvals_one_open", "approvals", "parameter_set_id", "state = 'OPEN'")


def _records() -> None:
    _table(
        "signatures",
        _key(),
        _refers("approval_id", "approvals"),
        _refers("user_id", "users"),
        _text("printed_name"),
        _text("decision"),
        _text("meaning"),
        _text("comment"),
        _text("shown_sha256"),
        _text("signed_utc"),
        _one_of("decision", "'APPROVE', 'REFUSE'"),
        sa.UniqueConstraint("approval_id", "user_id"),
    )
    _table(
        "uplinks",
        _key(),
        _refers("parameter_set_id", "parameter_sets"),
        _text("onboard_state"),
        _text("source"),
        _text("recorded_utc"),
        _refers("recorded_by", "users"),
        _one_of("onboard_state", ONBOARD_STATES),
    )
    op.create_index("ix_uplinks_parameter_set_id", "uplinks", ["parameter_set_id"])
    _table(
        "promotions",
        _key(),
        _refers("sensor_id", "sensors"),
        _refers("parameter_set_id", "parameter_sets"),
        _refers("approval_id", "approvals", nullable=True),
        _text("at_utc"),
        _refers("promoted_by", "users", nullable=True),
    )
    op.create_index("ix_promotions_sensor_id_at_utc", "promotions", ["sensor_id", "at_utc"])
    _table(
        "audit",
        _key(),
        _text("at_utc"),
        _number("actor_id", nullable=True),
        _text("actor"),
        _text("credential"),
        _text("action"),
        _text("object"),
        _text("before", nullable=True),
        _text("after", nullable=True),
        _text("reason", nullable=True),
        _text("request_id", nullable=True),
        _text("previous_hash"),
        sa.Column("hash", sa.Text(), nullable=False, unique=True),
    )
    op.create_index("ix_audit_object_id", "audit", ["object", "id"])
    _table(
        "idempotent_responses",
        sa.Column("key", sa.Text(), primary_key=True),
        sa.Column("actor", sa.Text(), primary_key=True),
        _text("request_sha256"),
        _number("status"),
        _text("headers"),
        _text("body"),
        _text("created_utc"),
    )


def _guards() -> None:
    """Make the triggers, in the words of each engine."""
    if op.get_bind().dialect.name == "postgresql":
        for function, words in (("refuse_change", "is never changed"), ("refuse_removal", "is never removed")):
            op.execute(
                f"CREATE FUNCTION {function}() RETURNS trigger LANGUAGE plpgsql AS "
                f"$$ BEGIN RAISE EXCEPTION '% {words}', TG_ARGV[0]; END $$"
            )
    for table in APPEND_ONLY:
        _guard_change(table, f"a record of {table}", "", ())
        _guard_removal(table, f"a record of {table}")
    _guard_change("runs", "the end of a run", *END_OF_RUN)
    _guard_change("parameter_sets", "the body of a parameter set", *BODY_OF_SET)
    _guard_removal("parameter_sets", "a parameter set")


def _guard_change(table: str, what: str, when: str, columns: tuple[str, ...]) -> None:
    """Refuse an update: of any column, or of these columns to another value, while a condition holds."""
    if op.get_bind().dialect.name == "postgresql":
        moved = " OR ".join(f"NEW.{column} IS DISTINCT FROM OLD.{column}" for column in columns)
        body = f"EXECUTE FUNCTION refuse_change('{what}')"
    else:
        moved = " OR ".join(f"NEW.{column} IS NOT OLD.{column}" for column in columns)
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never changed'); END"
    condition = " AND ".join(f"({part})" for part in (when, moved) if part)
    when_clause = f"WHEN ({condition}) " if condition else ""
    op.execute(f"CREATE TRIGGER {table}_no_change BEFORE UPDATE ON {table} FOR EACH ROW {when_clause}{body}")


def _guard_removal(table: str, what: str) -> None:
    """Refuse to delete a row, and on PostgreSQL to truncate the table."""
    if op.get_bind().dialect.name == "postgresql":
        body = f"EXECUTE FUNCTION refuse_removal('{what}')"
        op.execute(f"CREATE TRIGGER {table}_no_truncation BEFORE TRUNCATE ON {table} FOR EACH STATEMENT {body}")
    else:
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never removed'); END"
    op.execute(f"CREATE TRIGGER {table}_no_removal BEFORE DELETE ON {table} FOR EACH ROW {body}")
