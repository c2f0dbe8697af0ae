"""Requests that an alignment goes on board, each with its one signature. What was asked never changes, and none is removed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None

TABLE = "alignment_requests"
STATES = "'OPEN', 'APPROVED', 'REJECTED', 'WITHDRAWN'"
FIXED = ("alignment_id", "result_sha256", "reason", "submitted_utc", "submitted_by")


def upgrade() -> None:
    """Add the table and its guards."""
    op.create_table(
        TABLE,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("alignment_id", sa.Integer(), sa.ForeignKey("alignments.id"), nullable=False),
        sa.Column("result_sha256", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("submitted_utc", sa.Text(), nullable=False),
        sa.Column("submitted_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("closed_utc", sa.Text(), nullable=True),
        sa.Column("signed_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        *(sa.Column(name, sa.Text(), nullable=True) for name in ("printed_name", "meaning", "comment")),
        sa.CheckConstraint(f"state IN ({STATES})", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_alignment_requests_alignment_id", TABLE, ["alignment_id"])
    where = sa.text("state IN ('OPEN', 'APPROVED')")
    name = "uq_alignment_requests_one_in_force"
    op.create_index(name, TABLE, ["alignment_id"], unique=True, sqlite_where=where, postgresql_where=where)
    _guard()


def downgrade() -> None:
    """Take the table away, its guards with it."""
    op.drop_table(TABLE)


def _guard() -> None:
    """Refuse to remove a request, to change what was asked, and to change one that is closed."""
    is_postgresql = op.get_bind().dialect.name == "postgresql"
    differs = "IS DISTINCT FROM" if is_postgresql else "IS NOT"
    moved = " OR ".join([*(f"NEW.{name} {differs} OLD.{name}" for name in FIXED), "OLD.state <> 'OPEN'"])
    for kind, past, statement, what, when in (
        ("removal", "removed", "DELETE", f"a row of {TABLE}", ""),
        ("change", "changed", "UPDATE", f"what a row of {TABLE} says", f"WHEN ({moved}) "),
    ):
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
        if is_postgresql:
            body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        op.execute(f"CREATE TRIGGER {TABLE}_no_{kind} BEFORE {statement} ON {TABLE} FOR EACH ROW {when}{body}")
    if is_postgresql:
        truncation = f"{TABLE}_no_truncation BEFORE TRUNCATE ON {TABLE}"
        op.execute(
            f"CREATE TRIGGER {truncation} FOR EACH STATEMENT EXECUTE FUNCTION refuse_removal('a row of {TABLE}')"
        )
