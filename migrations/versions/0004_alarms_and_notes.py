"""Alarms with their history, and notes: what the fleet says by itself, and what people write down about it.

The guards are those of the other records: an alarm's events and the notes are only ever added, no alarm is removed, what
raised one is never rewritten, and one that is closed stays as it is. One alarm of a source is open at a time.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

APPEND_ONLY = ("alarm_events", "notes")
ORIGIN = ("source", "sensor_id", "kind", "raised_utc")  # of an alarm
KINDS = "'DRIFT', 'AGE', 'MISMATCH', 'CHAIN'"
LEVELS = "'critical', 'serious', 'caution'"
EVENTS = (
    "'RAISED', 'RETURNED', 'RAISED AGAIN', 'ACKNOWLEDGED', 'SHELVED', 'UNSHELVED', 'ASSIGNED', 'COMMENTED', 'CLOSED'"
)


def upgrade() -> None:
    """Add the tables and their guards."""
    _alarms()
    _events()
    _notes()
    for table in APPEND_ONLY:
        _guard(table, "change", "UPDATE", f"a record of {table}")
        _guard(table, "removal", "DELETE", f"a record of {table}")
    _guard("alarms", "removal", "DELETE", "a row of alarms")
    moved = " OR ".join(_moved(column) for column in ORIGIN)
    _guard(
        "alarms",
        "change",
        "UPDATE",
        "what raised an alarm, or a closed alarm,",
        f"{moved} OR OLD.closed_utc IS NOT NULL",
    )


def downgrade() -> None:
    """Take the tables away again, their guards with them."""
    for table in ("notes", "alarm_events", "alarms"):
        op.drop_table(table)


def _text(name: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Text(), nullable=nullable)


def _number(name: str) -> sa.Column:
    return sa.Column(name, sa.Integer(), nullable=False)


def _refers(name: str, target: str, *, nullable: bool = False) -> sa.Column:
    return sa.Column(name, sa.Integer(), sa.ForeignKey(target), nullable=nullable)


def _table(name: str, *parts: sa.Column | sa.Constraint) -> None:
    op.create_table(name, sa.Column("id", sa.Integer(), primary_key=True), *parts, sqlite_strict=True)


def _alarms() -> None:
    _table(
        "alarms",
        _text("source"),
        _refers("sensor_id", "sensors.id", nullable=True),
        _text("kind"),
        _text("level"),
        _text("sentence"),
        _text("evidence"),
        _number("active"),
        _number("acknowledged"),
        _text("raised_utc"),
        _text("returned_utc", nullable=True),
        _text("shelved_until_utc", nullable=True),
        _refers("assigned_to", "users.id", nullable=True),
        _number("version"),
        _text("closed_utc", nullable=True),
        sa.CheckConstraint(f"kind IN ({KINDS})", name="kind"),
        sa.CheckConstraint(f"level IN ({LEVELS})", name="level"),
    )
    op.create_index("ix_alarms_sensor_id", "alarms", ["sensor_id"])
    is_open = sa.text("closed_utc IS NULL")
    op.create_index(
        "uq_alarms_one_open", "alarms", ["source"], unique=True, sqlite_where=is_open, postgresql_where=is_open
    )


def _events() -> None:
    _table(
        "alarm_events",
        _refers("alarm_id", "alarms.id"),
        _text("event"),
        _refers("user_id", "users.id", nullable=True),
        _text("printed_name"),
        _text("text"),
        _text("at_utc"),
        sa.CheckConstraint(f"event IN ({EVENTS})", name="event"),
    )
    op.create_index("ix_alarm_events_alarm_id", "alarm_events", ["alarm_id"])


def _notes() -> None:
    _table(
        "notes",
        _text("subject_kind"),
        _number("subject_id"),
        _refers("user_id", "users.id"),
        _text("printed_name"),
        _text("text"),
        _text("made_utc"),
        sa.CheckConstraint("subject_kind IN ('runs', 'sensors', 'parameter-sets')", name="subject_kind"),
    )
    op.create_index("ix_notes_subject", "notes", ["subject_kind", "subject_id"])


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
