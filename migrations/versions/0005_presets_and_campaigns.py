"""Presets, and campaigns: one setting over many sensors.

A preset's settings never change: a new version is a new row, and only archiving touches an old one. Neither is a
campaign or its runs rewritten, except that a campaign is marked when all of it is cancelled; no row is removed.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

OF_PRESET = ("name", "number", "sentence", "document", "created_utc", "created_by")
OF_CAMPAIGN = ("label", "preset", "settings", "launched_utc", "launched_by")
TABLES = ("presets", "campaigns", "campaign_runs")


def upgrade() -> None:
    """Add the tables and their guards."""
    _presets()
    _campaigns()
    _runs()
    for table in TABLES:
        _guard(table, "removal", "DELETE", f"a row of {table}")
    _guard("presets", "change", "UPDATE", "what a preset says", " OR ".join(map(_moved, OF_PRESET)))
    _guard("campaigns", "change", "UPDATE", "what a campaign is", " OR ".join(map(_moved, OF_CAMPAIGN)))
    _guard("campaign_runs", "change", "UPDATE", "a record of campaign_runs")


def downgrade() -> None:
    """Take the tables away again, their guards with them."""
    for table in reversed(TABLES):
        op.drop_table(table)


def _text(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Text(), nullable=nullable)


def _refers(name: str, target: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Integer(), sa.ForeignKey(target), nullable=nullable)


def _table(name: str, *parts: sa.Column | sa.Constraint) -> None:
    op.create_table(name, sa.Column("id", sa.Integer(), primary_key=True), *parts, sqlite_strict=True)


def _presets() -> None:
    _table(
        "presets",
        _text("name"),
        sa.Column("number", sa.Integer(), nullable=False),
        _text("sentence"),
        _text("document"),
        _text("created_utc"),
        _refers("created_by", "users.id", nullable=True),
        _text("archived_utc", nullable=True),
        sa.UniqueConstraint("name", "number"),
    )


def _campaigns() -> None:
    _table(
        "campaigns",
        _text("label"),
        _text("preset", nullable=True),
        _text("settings"),
        _text("launched_utc"),
        _refers("launched_by", "users.id", nullable=True),
        _text("cancelled_utc", nullable=True),
    )


def _runs() -> None:
    _table(
        "campaign_runs",
        _refers("campaign_id", "campaigns.id"),
        _refers("sensor_id", "sensors.id"),
        _refers("run_id", "runs.id", nullable=True),
        _text("refusal", nullable=True),
    )
    op.create_index("ix_campaign_runs_campaign_sensor", "campaign_runs", ["campaign_id", "sensor_id", "id"])
    op.create_index("ix_campaign_runs_run_id", "campaign_runs", ["run_id"])


def _moved(column: str) -> str:
    """Say in the engine's words that an update changes a column."""
    return f"NEW.{column} {'IS DISTINCT FROM' if _is_postgresql() else 'IS NOT'} OLD.{column}"


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
