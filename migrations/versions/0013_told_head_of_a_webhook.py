"""A webhook keeps which head of the audit log it was told of newest; it was looked for in the messages."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column and fill it from the newest message about a head."""
    op.add_column("webhooks", sa.Column("told_head", sa.Text()))
    connection = op.get_bind()
    webhooks = sa.table("webhooks", sa.column("id"), sa.column("told_head"))
    deliveries = sa.table("webhook_deliveries", *map(sa.column, ("id", "webhook_id", "body")))
    for (webhook_id,) in connection.execute(sa.select(webhooks.c.id)).all():
        of_heads = deliveries.c.body.contains('"type": "audit.head"', autoescape=True)
        query = sa.select(deliveries.c.body).where(deliveries.c.webhook_id == webhook_id, of_heads)
        body = connection.scalar(query.order_by(deliveries.c.id.desc()).limit(1))
        if body is not None:
            told = json.loads(body)["data"]["audit_hash"]
            connection.execute(webhooks.update().where(webhooks.c.id == webhook_id).values(told_head=told))


def downgrade() -> None:
    """Take the column away; the messages have what it said."""
    op.drop_column("webhooks", "told_head")
