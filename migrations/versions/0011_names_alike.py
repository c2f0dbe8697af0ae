"""Keys of people's names, so that no two look alike; failed log-ins are counted in memory and told by the audit log.

The key is the name in NFKC form without regard to case. Where an older version let two people have names with one key, the older
person keeps the key and the other one has none: both go on as before, each logs in with the name exactly as it is written, and no
third one can take it.
"""

from __future__ import annotations

import logging
import unicodedata

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

KEYS = {"name_key": "name", "printed_key": "printed_name"}
log = logging.getLogger("boresight.migrations")


def upgrade() -> None:
    """Add the keys, and give them to who is there; remove the table of failed log-ins."""
    for column in KEYS:
        op.add_column("users", sa.Column(column, sa.Text()))
    for column, name in KEYS.items():
        _fill(column, name)
        op.create_index(f"uq_users_{column}", "users", [column], unique=True)
    op.drop_table("login_failures")


def downgrade() -> None:
    """Take them away again, and make the table again."""
    for column in KEYS:
        op.drop_index(f"uq_users_{column}", "users")
        op.drop_column("users", column)
    op.create_table(
        "login_failures",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("at_utc", sa.Text(), nullable=False),
        sqlite_strict=True,
    )
    op.create_index("ix_login_failures_name_at_utc", "login_failures", ["name", "at_utc"])


def _fill(column: str, name: str) -> None:
    """Give every person the key of a name, the first of several who share one."""
    users = sa.table("users", sa.column("id"), sa.column(name), sa.column(column))
    connection, taken = op.get_bind(), {}
    for user_id, text in connection.execute(sa.select(users.c.id, users.c[name]).order_by(users.c.id)).all():
        key = _key(text)
        if key in taken:
            log.warning("users/%d and users/%d have names alike: %r", taken[key], user_id, text)
            continue
        taken[key] = user_id
        connection.execute(users.update().where(users.c.id == user_id).values({column: key}))


def _key(name: str) -> str:
    return _normal(_normal(name).casefold())


def _normal(text: str) -> str:
    once = " ".join(part for part in unicodedata.normalize("NFKC", text).split(" ") if part)
    return unicodedata.normalize("NFKC", once)
