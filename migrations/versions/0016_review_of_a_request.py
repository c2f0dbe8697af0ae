"""What a signature says of the points against a request, and threads about a gate, a parameter or a figure.

The new columns stay empty in rows that are there, whose seals hold: a signature of before says nothing of points, and a remark of
before is about the whole request. They have no foreign key, for which SQLite would copy the table.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None

OF_THREAD = ("approval_id", "kind", "name", "opened_by", "printed_name", "opened_utc")
TABLE = "threads"


def upgrade() -> None:
    """Add the table with its guards, and the columns."""
    op.create_table(
        TABLE,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("approval_id", sa.Integer(), sa.ForeignKey("approvals.id"), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("opened_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("printed_name", sa.Text(), nullable=False),
        sa.Column("opened_utc", sa.Text(), nullable=False),
        sa.Column("resolved_by", sa.Integer(), nullable=True),
        sa.Column("resolver", sa.Text(), nullable=True),
        sa.Column("resolved_utc", sa.Text(), nullable=True),
        sa.CheckConstraint("kind IN ('gate', 'parameter', 'figure')", name="kind"),
        sa.CheckConstraint("state IN ('OPEN', 'RESOLVED')", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_threads_approval_id", TABLE, ["approval_id"])
    _guard("removal", "DELETE", f"a row of {TABLE}")
    _guard("change", "UPDATE", "what a thread is about", " OR ".join(map(_moved, OF_THREAD)))
    op.add_column("signatures", sa.Column("points", sa.Text(), nullable=True))
    op.add_column("remarks", sa.Column("thread_id", sa.Integer(), nullable=True))
    op.add_column("remarks", sa.Column("mentions", sa.Text(), nullable=True))
    op.create_index("ix_remarks_thread_id", "remarks", ["thread_id"])


def downgrade() -> None:
    """Take them away; remarks of a thread stay in the discussion of the whole request."""
    op.drop_index("ix_remarks_thread_id", "remarks")
    for table, column in (("remarks", "mentions"), ("remarks", "thread_id"), ("signatures", "points")):
        op.execute(f'ALTER TABLE {table} DROP COLUMN "{column}"')
    op.drop_table(TABLE)


def _moved(column: str) -> str:
    """Say in the engine's words that an update changes a column."""
    return f"NEW.{column} {'IS DISTINCT FROM' if _is_postgresql() else 'IS NOT'} OLD.{column}"


def _is_postgresql() -> bool:
    return bool(op.get_bind().dialect.name == "postgresql")


def _guard(kind: str, statement: str, what: str, condition: str = "") -> None:
    """Refuse a statement on the table, of any row or of those that meet a condition."""
    past = "changed" if kind == "change" else "removed"
    if _is_postgresql():
        body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        if kind == "removal":
            op.execute(f"CREATE TRIGGER {TABLE}_no_truncation BEFORE TRUNCATE ON {TABLE} FOR EACH STATEMENT {body}")
    else:
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
    when = f"WHEN ({condition}) " if condition else ""
    op.execute(f"CREATE TRIGGER {TABLE}_no_{kind} BEFORE {statement} ON {TABLE} FOR EACH ROW {when}{body}")
