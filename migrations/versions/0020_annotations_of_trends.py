"""What people say of times of a sensor's mission; rows are only ever added."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

TABLE = "annotations"


def upgrade() -> None:
    """Add the table with its guards."""
    op.create_table(
        TABLE,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=False),
        sa.Column("at_utc", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("printed_name", sa.Text(), nullable=False),
        sa.Column("made_utc", sa.Text(), nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_annotations_sensor_id", TABLE, ["sensor_id"])
    for kind, statement in (("change", "UPDATE"), ("removal", "DELETE")):
        _guard(kind, statement)


def downgrade() -> None:
    """Take the table away again, its guards with it; the audit log has what was said."""
    op.drop_table(TABLE)


def _guard(kind: str, statement: str) -> None:
    """Refuse a statement on any row of the table."""
    what = f"a record of {TABLE}"
    if op.get_bind().dialect.name == "postgresql":
        body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        if kind == "removal":
            op.execute(f"CREATE TRIGGER {TABLE}_no_truncation BEFORE TRUNCATE ON {TABLE} FOR EACH STATEMENT {body}")
    else:
        past = "changed" if kind == "change" else "removed"
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
    op.execute(f"CREATE TRIGGER {TABLE}_no_{kind} BEFORE {statement} ON {TABLE} FOR EACH ROW {body}")
