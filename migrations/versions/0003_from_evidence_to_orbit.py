"""Gates, waivers, the discussion of a request, table definitions, packages, webhooks; history that cannot be changed.

Columns are only added, so SQLite alters in place and the triggers of before stay. New triggers say in the database what
the services say in Python: a profile, a report, a waiver, a remark, a definition and a package are only ever added; what
a request asks for never changes, and a request that is closed stays closed; nobody's row and no webhook's is removed.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

APPEND_ONLY = ("gate_profiles", "gate_reports", "waivers", "remarks", "openings", "table_definitions", "packages")
KEPT = ("approvals", "users", "api_keys", "sensors", "webhooks", "webhook_deliveries")  # rows that are never removed
BODY_OF_REQUEST = (
    "parameter_set_id",
    "reason",
    "submitted_utc",
    "submitted_by",
    "bound",
    "kind",
    "needed",
    "expires_utc",
)
CLOSED = "OLD.state IN ('REJECTED', 'WITHDRAWN', 'STALE', 'EXPIRED')"
NEW_COLUMNS = (
    ("users", "must_change_password", "INTEGER DEFAULT 0 NOT NULL"),
    ("api_keys", "last_used_utc", "TEXT"),
    ("approvals", "kind", "TEXT DEFAULT 'PROMOTION' NOT NULL"),
    ("approvals", "needed", "INTEGER DEFAULT 1 NOT NULL"),
    ("approvals", "expires_utc", "TEXT"),
    ("approvals", "assigned_to", "INTEGER"),
    ("signatures", "console", "TEXT"),
    ("signatures", "password_by", "TEXT"),
    ("uplinks", "method", "TEXT"),
    ("uplinks", "evidence", "TEXT"),
    ("uplinks", "printed_name", "TEXT"),
    ("uplinks", "meaning", "TEXT"),
    ("audit", "rows", "TEXT"),
    ("audit", "roles", "TEXT"),
)


def upgrade() -> None:
    """Add the columns, the tables and the guards."""
    for table, column, kind in NEW_COLUMNS:
        op.execute(f'ALTER TABLE {table} ADD COLUMN "{column}" {kind}')
    _gates()
    _discussion()
    _packages()
    _webhooks()
    for table in APPEND_ONLY:
        _guard(table, "change", "UPDATE", f"a record of {table}")
        _guard(table, "removal", "DELETE", f"a record of {table}")
    for table in KEPT:
        _guard(table, "removal", "DELETE", f"a row of {table}")
    moved = " OR ".join(_moved(column) for column in BODY_OF_REQUEST)
    _guard("approvals", "change", "UPDATE", "what a request asks for", f"{moved} OR ({CLOSED} AND {_moved('state')})")


def downgrade() -> None:
    """Take guards, tables and columns away again."""
    if _is_postgresql():  # records were numbered by their writer; the older version lets the sequence number them
        op.execute("SELECT setval(pg_get_serial_sequence('audit', 'id'), coalesce(max(id), 0) + 1, false) FROM audit")
    _drop_guard("approvals", "change")
    for table in KEPT:
        _drop_guard(table, "removal")
    for table in ("webhook_deliveries", "webhooks", "packages", "table_definitions", "openings", "remarks"):
        op.drop_table(table)
    for table in ("waivers", "gate_reports", "gate_profiles"):
        op.drop_table(table)
    for table, column, _ in reversed(NEW_COLUMNS):
        op.execute(f'ALTER TABLE {table} DROP COLUMN "{column}"')


def _key() -> sa.Column:
    return sa.Column("id", sa.Integer(), primary_key=True)


def _text(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Text(), nullable=nullable)


def _number(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Integer(), nullable=nullable)


def _refers(name: str, target: str, *, nullable: bool = False) -> sa.Column:
    kind = sa.Text() if target == "blobs.sha256" else sa.Integer()
    return sa.Column(name, kind, sa.ForeignKey(target), nullable=nullable)


def _table(name: str, *parts: sa.Column | sa.Constraint, index: str = "") -> None:
    op.create_table(name, _key(), *parts, sqlite_strict=True)
    if index:
        op.create_index(f"ix_{name}_{index}", name, [index])


def _versioned(name: str) -> None:
    """Make a table of documents, each version of a sensor's a row."""
    _table(
        name,
        _refers("sensor_id", "sensors.id"),
        _number("number"),
        _text("document"),
        _text("sha256"),
        _text("reason"),
        _text("created_utc"),
        _refers("created_by", "users.id", nullable=True),
        sa.UniqueConstraint("sensor_id", "number"),
    )


def _gates() -> None:
    _versioned("gate_profiles")
    _table(
        "gate_reports",
        _refers("parameter_set_id", "parameter_sets.id"),
        _refers("gate_profile_id", "gate_profiles.id"),
        _text("verdict"),
        _text("document"),
        _text("sha256"),
        _text("created_utc"),
        _refers("created_by", "users.id", nullable=True),
        index="parameter_set_id",
    )
    _table(
        "waivers",
        _refers("parameter_set_id", "parameter_sets.id"),
        _refers("gate_report_id", "gate_reports.id"),
        _text("gate"),
        _text("code"),
        _text("reason"),
        _text("expires_utc"),
        _text("made_utc"),
        _refers("made_by", "users.id"),
        _text("printed_name"),
        index="parameter_set_id",
    )


def _discussion() -> None:
    _table(
        "remarks",
        _refers("approval_id", "approvals.id"),
        _refers("user_id", "users.id"),
        _text("printed_name"),
        _text("text"),
        _text("made_utc"),
        index="approval_id",
    )
    _table(
        "openings",
        _refers("approval_id", "approvals.id"),
        _refers("user_id", "users.id"),
        _text("evidence"),
        _text("opened_utc"),
        sa.UniqueConstraint("approval_id", "user_id", "evidence"),
    )


def _packages() -> None:
    _versioned("table_definitions")
    _table(
        "packages",
        _refers("parameter_set_id", "parameter_sets.id"),
        _refers("table_definition_id", "table_definitions.id", nullable=True),
        _text("inputs"),
        _refers("sha256", "blobs.sha256"),
        _text("created_utc"),
        _refers("created_by", "users.id", nullable=True),
        index="parameter_set_id",
    )


def _webhooks() -> None:
    _table(
        "webhooks",
        _text("label"),
        _text("url"),
        _text("actions"),
        _text("secret"),
        _number("version"),
        _number("told_audit_id"),
        _text("created_utc"),
        _refers("created_by", "users.id", nullable=True),
        _text("disabled_utc", nullable=True),
    )
    _table(
        "webhook_deliveries",
        _refers("webhook_id", "webhooks.id"),
        _number("audit_id", nullable=True),
        _text("body"),
        _text("state"),
        _number("attempts"),
        _text("due_utc"),
        _text("attempted_utc", nullable=True),
        _number("status", nullable=True),
        _text("outcome", nullable=True),
        _text("created_utc"),
        sa.CheckConstraint("state IN ('PENDING', 'DELIVERED', 'FAILED')", name="state"),
        index="webhook_id",
    )
    op.create_index("ix_webhook_deliveries_state_due_utc", "webhook_deliveries", ["state", "due_utc"])


def _moved(column: str) -> str:
    """Say in the engine's words that an update changes a column."""
    is_not = "IS DISTINCT FROM" if _is_postgresql() else "IS NOT"
    return f"NEW.{column} {is_not} OLD.{column}"


def _is_postgresql() -> bool:
    return bool(op.get_bind().dialect.name == "postgresql")


def _guard(table: str, kind: str, statement: str, what: str, condition: str = "") -> None:
    """Refuse a statement on a table, of any row or of those that meet a condition."""
    past = "changed" if kind == "change" else "removed"
    if _is_postgresql():
        body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        if kind == "removal":
            op.execute(f"CREATE TRIGGER {table}_no_truncation BEFORE TRUNCATE ON {table} FOR EACH STATEMENT {body}")
    else:
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
    when = f"WHEN ({condition}) " if condition else ""
    op.execute(f"CREATE TRIGGER {table}_no_{kind} BEFORE {statement} ON {table} FOR EACH ROW {when}{body}")


def _drop_guard(table: str, kind: str) -> None:
    """Take a guard away; SQLite names a trigger without its table."""
    of_table = f" ON {table}" if _is_postgresql() else ""
    op.execute(f"DROP TRIGGER {table}_no_{kind}{of_table}")
    if kind == "removal" and _is_postgresql():
        op.execute(f"DROP TRIGGER {table}_no_truncation{of_table}")
