"""Second factors with their recovery codes and challenges, and the identities that single sign-on binds accounts to."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None

LOG_IN_COLUMNS = ("method", "factor_kind", "confirmed_utc")


def upgrade() -> None:
    """Add the tables, and to a log-in how it was made."""
    op.add_column("login_sessions", sa.Column("method", sa.Text(), nullable=False, server_default="password"))
    op.add_column("login_sessions", sa.Column("factor_kind", sa.Text(), nullable=True))
    op.add_column("login_sessions", sa.Column("confirmed_utc", sa.Text(), nullable=True))
    _create(
        "external_identities",
        _text("issuer"),
        _text("subject"),
        _text("created_utc"),
        sa.UniqueConstraint("user_id", name="uq_external_identities_user_id"),
        sa.UniqueConstraint("issuer", "subject", name="uq_external_identities_issuer"),
    )
    _create(
        "second_factors",
        _text("kind"),
        _text("label"),
        _text("secret"),
        sa.Column("credential_id", sa.Text(), nullable=True, unique=True),
        sa.Column("rp_id", sa.Text(), nullable=True),
        _text("created_utc"),
        sa.Column("ended_utc", sa.Text(), nullable=True),
        sa.Column("ended_because", sa.Text(), nullable=True),
        sa.Column("last_used_utc", sa.Text(), nullable=True),
        sa.Column("last_step", sa.Integer(), nullable=False),
        sa.Column("sign_count", sa.BigInteger().with_variant(sa.Integer, "sqlite"), nullable=False),
        sa.CheckConstraint("kind IN ('totp', 'webauthn')", name="kind"),
        sa.CheckConstraint("ended_because IN ('removed', 'reset')", name="ended_because"),
    )
    _create(
        "recovery_codes",
        sa.Column("code_hash", sa.Text(), nullable=False, unique=True),
        _text("created_utc"),
        sa.Column("ended_utc", sa.Text(), nullable=True),
        sa.Column("ended_because", sa.Text(), nullable=True),
        sa.CheckConstraint("ended_because IN ('used', 'replaced', 'reset')", name="ended_because"),
    )
    _create(
        "factor_challenges",
        _text("purpose"),
        sa.Column("token_hash", sa.Text(), nullable=True, unique=True),
        sa.Column("session_id", sa.Integer(), sa.ForeignKey("login_sessions.id"), nullable=True),
        sa.Column("method", sa.Text(), nullable=True),
        _text("challenge"),
        _text("created_utc"),
        sa.Column("ended_utc", sa.Text(), nullable=True),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.CheckConstraint("purpose IN ('log-in', 'sign', 'totp', 'webauthn')", name="purpose"),
    )
    op.create_index("ix_factor_challenges_created_utc", "factor_challenges", ["created_utc"])
    for table in ("second_factors", "recovery_codes", "factor_challenges"):
        op.create_index(f"ix_{table}_user_id", table, ["user_id"])


def downgrade() -> None:
    """Take them away: accounts of single sign-on stay without a way in, and nobody is asked for a second factor."""
    for table in ("factor_challenges", "recovery_codes", "second_factors", "external_identities"):
        op.drop_table(table)
    for column in LOG_IN_COLUMNS:
        op.drop_column("login_sessions", column)


def _text(name: str) -> sa.Column[str]:
    return sa.Column(name, sa.Text(), nullable=False)


def _create(table: str, *columns: sa.schema.SchemaItem) -> None:
    op.create_table(
        table,
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("user_id", sa.Integer(), sa.ForeignKey("users.id"), nullable=False),
        *columns,
        sqlite_strict=True,
    )
