"""Changes of gate limits and table layouts that wait for a second person.

What a proposal says, and who proposed it, never changes; no proposal is removed.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

KINDS = "'gate-profile', 'table-definition'"
STATES = "'OPEN', 'CONFIRMED', 'REFUSED', 'WITHDRAWN', 'STALE', 'EXPIRED'"
FIXED = (
    "sensor_id",
    "kind",
    "base_number",
    "document",
    "sha256",
    "reason",
    "proposed_utc",
    "proposed_by",
    "expires_utc",
)


def upgrade() -> None:
    """Add the table and its guards."""
    op.create_table(
        "change_proposals",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("sensor_id", sa.Integer(), sa.ForeignKey("sensors.id"), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("base_number", sa.Integer(), nullable=False),
        sa.Column("document", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("proposed_utc", sa.Text(), nullable=False),
        sa.Column("proposed_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        sa.Column("expires_utc", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("closed_utc", sa.Text(), nullable=True),
        sa.Column("closed_by", sa.Integer(), sa.ForeignKey("users.id"), nullable=True),
        sa.Column("comment", sa.Text(), nullable=True),
        sa.Column("number", sa.Integer(), nullable=True),
        sa.CheckConstraint(f"kind IN ({KINDS})", name="kind"),
        sa.CheckConstraint(f"state IN ({STATES})", name="state"),
        sqlite_strict=True,
    )
    op.create_index("ix_change_proposals_sensor_id_state", "change_proposals", ["sensor_id", "state"])
    postgresql = op.get_bind().dialect.name == "postgresql"
    moved = " OR ".join(f"NEW.{name} {'IS DISTINCT FROM' if postgresql else 'IS NOT'} OLD.{name}" for name in FIXED)
    _guard("removal", "DELETE", "a row of change_proposals", "", postgresql=postgresql)
    _guard("change", "UPDATE", "what a proposal says", f"WHEN ({moved} OR OLD.state <> 'OPEN') ", postgresql=postgresql)


def downgrade() -> None:
    """Take the table away again, its guards with it."""
    op.drop_table("change_proposals")


def _guard(kind: str, statement: str, what: str, when: str, *, postgresql: bool) -> None:
    """Refuse a statement on the table."""
    past = "changed" if kind == "change" else "removed"
    body = f"BEGIN SELECT RAISE(ABORT, '{what} is never {past}'); END"
    if postgresql:
        body = f"EXECUTE FUNCTION refuse_{kind}('{what}')"
        if kind == "removal":
            truncation = "change_proposals_no_truncation BEFORE TRUNCATE ON change_proposals"
            op.execute(f"CREATE TRIGGER {truncation} FOR EACH STATEMENT {body}")
    named = f"change_proposals_no_{kind} BEFORE {statement} ON change_proposals"
    op.execute(f"CREATE TRIGGER {named} FOR EACH ROW {when}{body}")
