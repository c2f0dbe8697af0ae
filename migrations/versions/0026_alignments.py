"""Alignments of two sensors. What was asked never changes, an end is written once, and no alignment is removed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None

STATES = "'QUEUED', 'RUNNING', 'SUCCEEDED', 'FAILED'"
ENDED = "'SUCCEEDED', 'FAILED'"
FIXED = ("sensor_a_id", "sensor_b_id", "run_a_id", "run_b_id", "options", "created_utc", "created_by")


def upgrade() -> None:
    """Add the table and its guards."""
    op.create_table(
        "alignments",
        sa.Column("id", sa.Integer(), primary_key=True),
        *(
            sa.Column(name, sa.Integer(), sa.ForeignKey(f"{table}.id"), nullable=False)
            for name, table in (
                ("sensor_a_id", "sensors"),
                ("sensor_b_id", "sensors"),
                ("run_a_id", "runs"),
                ("run_b_id", "runs"),
            )
        ),
        sa.Column("options", sa.Text(), nullable=False),
        sa.Column("created_utc", sa.Text(), nullable=False),
        sa.Column("created_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=True),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("lease_until_utc", sa.Text(), nullable=True),
        sa.Column("started_utc", sa.Text(), nullable=True),
        sa.Column("ended_utc", sa.Text(), nullable=True),
        sa.Column("result_sha256", sa.Text(), sa.ForeignKey("blobs.sha256"), nullable=True),
        sa.Column("verdict", sa.Text(), nullable=True),
        sa.Column("summary", sa.Text(), nullable=True),
        sa.CheckConstraint(f"state IN ({STATES})", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_alignments_state_id", "alignments", ["state", "id"])
    op.create_index("ix_alignments_sensor_a_id_sensor_b_id", "alignments", ["sensor_a_id", "sensor_b_id", "id"])
    op.create_index("ix_alignments_sensor_b_id", "alignments", ["sensor_b_id", "id"])
    _guard()


def downgrade() -> None:
    """Take the table away, its guards with it."""
    op.drop_table("alignments")


def _guard() -> None:
    """Refuse to remove an alignment, to change what was asked, and to change one that has ended."""
    is_postgresql = op.get_bind().dialect.name == "postgresql"
    differs = "IS DISTINCT FROM" if is_postgresql else "IS NOT"
    moved = " OR ".join([*(f"NEW.{name} {differs} OLD.{name}" for name in FIXED), f"OLD.state IN ({ENDED})"])
    for kind, past, statement, what, when in (
        ("removal", "removed", "DELETE", "a row of alignments", ""),
        ("change", "changed", "UPDATE", "what a row of alignments says", f"WHEN ({moved}) "),
    ):
        body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
        if is_postgresql:
            body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        op.execute(f"CREATE TRIGGER alignments_no_{kind} BEFORE {statement} ON alignments FOR EACH ROW {when}{body}")
    if is_postgresql:
        truncation = "alignments_no_truncation BEFORE TRUNCATE ON alignments"
        op.execute(
            f"CREATE TRIGGER {truncation} FOR EACH STATEMENT EXECUTE FUNCTION refuse_removal('a row of alignments')"
        )
