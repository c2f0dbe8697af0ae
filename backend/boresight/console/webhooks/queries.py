"""Queries on webhooks and their deliveries."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.platform.audit import queries as audit_rows
from boresight.platform.audit import seals as journals
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Engine, Session


def list_webhooks(session: Session, *, enabled_only: bool = False) -> Sequence[Webhook]:
    """Return every webhook, newest first, or the enabled ones only."""
    query = sa.select(Webhook).order_by(Webhook.id.desc())
    return session.scalars(query.where(Webhook.disabled_utc.is_(None)) if enabled_only else query).all()


def list_records_after(session: Session, audit_id: int, limit: int) -> Sequence[AuditRecord]:
    """Return audit records after a number, oldest first."""
    query = sa.select(AuditRecord).where(AuditRecord.id > audit_id).order_by(AuditRecord.id).limit(limit)
    return session.scalars(query).all()


def read_next_delivery_id(session: Session) -> int:
    """Return the number of the next message; the one writer at a time numbers them."""
    session.flush()
    return journals.newest(session, journals.AppendOnlyTable(WebhookDelivery))[0] + 1


def list_due(
    session: Session, now_utc: str, limit: int, of_each: int = 1, *, among: Collection[int]
) -> Sequence[tuple[WebhookDelivery, Webhook]]:
    """Return the due messages of some enabled webhooks, at most so many of each, one of each first."""
    place = sa.func.row_number().over(
        partition_by=WebhookDelivery.webhook_id, order_by=(WebhookDelivery.due_utc, WebhookDelivery.id)
    )
    is_due = (
        WebhookDelivery.state == "PENDING",
        WebhookDelivery.due_utc <= now_utc,
        WebhookDelivery.webhook_id.in_(among),
    )
    ranked = sa.select(WebhookDelivery.id, place.label("place")).where(*is_due).subquery()
    query = sa.select(WebhookDelivery, Webhook).join(Webhook, WebhookDelivery.webhook_id == Webhook.id)
    query = query.join(ranked, ranked.c.id == WebhookDelivery.id)
    query = query.where(ranked.c.place <= of_each, Webhook.disabled_utc.is_(None))
    found = session.execute(query.order_by(ranked.c.place, WebhookDelivery.due_utc, WebhookDelivery.id).limit(limit))
    return [(delivery, webhook) for delivery, webhook in found]


def put_off(session: Session, webhook_id: int, until_utc: str) -> None:
    """Postpone all waiting messages of a webhook to a time at least."""
    waits = (WebhookDelivery.webhook_id == webhook_id, WebhookDelivery.state == "PENDING")
    session.flush()
    session.execute(
        sa.update(WebhookDelivery).where(*waits, WebhookDelivery.due_utc < until_utc).values(due_utc=until_utc)
    )


def is_any_untold(session: Session) -> bool:
    """Whether there is an audit record without messages to a webhook yet."""
    newest = audit_rows.read_newest_id(session)
    untold = sa.select(Webhook.id).where(Webhook.disabled_utc.is_(None), Webhook.told_audit_id < newest).limit(1)
    return session.scalar(untold) is not None


def overwrite_what_is_deleted(session: Session) -> None:
    """Let SQLite write zeros over what this connection replaces; PostgreSQL's vacuum clears its pages."""
    if session.connection().dialect.name == "sqlite":
        session.connection().exec_driver_sql("PRAGMA secure_delete=ON").close()


def empty_journal(engine: Engine) -> None:
    """Checkpoint and truncate SQLite's write-ahead log, unless a reader is active."""
    if engine.dialect.name != "sqlite":
        return
    connection = engine.raw_connection()
    try:
        connection.cursor().execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    finally:
        connection.close()
