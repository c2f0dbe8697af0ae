"""A run may take further telemetry sets with its first, and start from an earlier calibration."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

STARTS = ("prior_run_id", "prior_set_id")


def upgrade() -> None:
    """Add the table and the columns; these without foreign keys, for which SQLite would copy the table of runs."""
    for name in STARTS:
        op.add_column("runs", sa.Column(name, sa.Integer(), nullable=True))
    op.create_table(
        "joint_sets",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("run_id", sa.Integer(), sa.ForeignKey("runs.id"), nullable=False),
        sa.Column("telemetry_set_id", sa.Integer(), sa.ForeignKey("telemetry_sets.id"), nullable=False),
        sa.UniqueConstraint("run_id", "telemetry_set_id"),
        sqlite_strict=True,
    )
    op.create_index("ix_joint_sets_telemetry_set_id", "joint_sets", ["telemetry_set_id"])


def downgrade() -> None:
    """Take them away; the results still name their passes and their prior, and the audit log what was launched."""
    op.drop_table("joint_sets")
    for name in STARTS:
        op.drop_column("runs", name)
