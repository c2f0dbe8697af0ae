"""Mapping profiles, and how a telemetry set was imported by one.

A saved profile never changes: a new version is a new row, and only archiving touches an old one. The two columns of a set stay
empty for telemetry that was uploaded as such; they have no foreign key, for which SQLite would copy the table.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

OF_PROFILE = ("name", "number", "document", "sha256", "created_utc", "created_by")
TABLE = "import_profiles"


def upgrade() -> None:
    """Add the table with its guards, and the columns."""
    op.create_table(
        TABLE,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.Column("created_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("archived_utc", sa.Text(), nullable=True),
        sa.UniqueConstraint("name", "number"),
        sqlite_strict=True,
    )
    _guard("removal", "DELETE", f"a row of {TABLE}")
    _guard("change", "UPDATE", "what a mapping profile says", " OR ".join(map(_moved, OF_PROFILE)))
    op.add_column("telemetry_sets", sa.Column("import_record", sa.Text(), nullable=True))
    op.add_column("telemetry_sets", sa.Column("source_sha256", sa.Text(), nullable=True))


def downgrade() -> None:
    """Take them away; imported sets stay as the telemetry that they are."""
    op.drop_column("telemetry_sets", "source_sha256")
    op.drop_column("telemetry_sets", "import_record")
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
