"""What people say of times of a sensor's mission, and files at notes; rows of both are only ever added."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

SAID, ATTACHED = "annotations", "note_attachments"


def upgrade() -> None:
    """Add the tables with their guards."""
    op.create_table(
        SAID,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=False),
        sa.Column("at_utc", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("printed_name", sa.Text(), nullable=False),
        sa.Column("made_utc", sa.Text(), nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_annotations_sensor_id", SAID, ["sensor_id"])
    op.create_table(
        ATTACHED,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("note_id", sa.Integer(), sa.ForeignKey("notes.id"), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), sa.ForeignKey("blobs.sha256"), nullable=False),
        sa.Column("size_bytes", sa.Integer(), nullable=False),
        sa.Column("made_utc", sa.Text(), nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_note_attachments_note_id", ATTACHED, ["note_id"])
    for table in (SAID, ATTACHED):
        _guard(table, "change", "UPDATE")
        _guard(table, "removal", "DELETE")


def downgrade() -> None:
    """Take the tables away again, their guards with them; the files stay, and the audit log has what was said and attached."""
    for table in (ATTACHED, SAID):
        op.drop_table(table)


def _guard(table: str, kind: str, statement: str) -> None:
    """Refuse a statement on any row of a table."""
    what = f"a record of {table}"
    if op.get_bind().dialect.name == "postgresql":
        body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        if kind == "removal":
            op.execute(f"CREATE TRIGGER {table}_no_truncation BEFORE TRUNCATE ON {table} FOR EACH STATEMENT {body}")
    else:
        past = "changed" if kind == "change" else "removed"
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
    op.execute(f"CREATE TRIGGER {table}_no_{kind} BEFORE {statement} ON {table} FOR EACH ROW {body}")
