"""A webhook's former secret, which signs beside the new one for a while.

Secrets that are stored plain are encrypted by the server, by `boresight migrate` and before a backup, for the key is in a
file and not in the database. On the way down they stay encrypted: an older version signs with a text that no receiver
knows, so that each webhook has to be made again, and tells nobody a secret.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

COLUMNS = ("previous_secret", "previous_until_utc")


def upgrade() -> None:
    """Add the columns."""
    for name in COLUMNS:
        op.add_column("webhooks", sa.Column(name, sa.Text(), nullable=True))


def downgrade() -> None:
    """Take them away again."""
    for name in COLUMNS:
        op.drop_column("webhooks", name)
