"""Webhooks: telling other programs what happened, at least once, signed, with a log of every message.

A message is a row before it is sent; whoever receives the same `webhook-id` twice knows it by that. Failed attempts are
repeated after 5 s, and then four times as long each time; the eighth is the last. The headers are those of Standard
Webhooks::

    webhook-signature: v1,base64(HMAC-SHA256(k, id "." t "." body))

with the key k behind `whsec_`, signed again for every attempt, and by each secret while a former one still holds.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from boresight.console import list_queries as lists
from boresight.console.webhooks import queries as rows
from boresight.console.webhooks.secrets import decode_key, list_readable_ids, new_secret
from boresight.console.webhooks.tables import Webhook, WebhookDelivery
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import Actor, refuse_key, require_role
from boresight.platform.audit import log as audit
from boresight.platform.audit import queries as audit_rows
from boresight.platform.audit.external_head import ExternalHead
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session, utc_after, utc_now
from boresight.platform.web.targets import WebhookTargets, parsed, refuse_address
from boresight.platform.web.text_validation import refuse_control_characters


def sign_message(secrets: Sequence[str], message_id: str, timestamp: int, body: str) -> str:
    """Return the `webhook-signature` of a message sent at a second of Unix time, by each secret that holds."""
    signed = f"{message_id}.{timestamp}.{body}".encode()
    digests = (hmac.new(decode_key(secret), signed, hashlib.sha256).digest() for secret in secrets)
    return " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in digests)


def make_message_id(delivery_id: int) -> str:
    """Return the id under which a receiver knows a message again."""
    return f"msg_{delivery_id}"


def name_kind(record: AuditRecord) -> str:
    """Name the kind of an audit record: `parameter-sets.promoted`."""
    return f"{record.subject.noun}.{'-'.join(record.action.split())}"


def make_message(record: AuditRecord) -> dict[str, object]:
    """Make the webhook message of an audit record."""
    return {
        "type": name_kind(record),
        "at_utc": record.at_utc,
        "object": record.object,
        "action": record.action,
        "actor": record.actor,
        "data": {"before": record.before, "after": record.after, "reason": record.reason, "audit_hash": record.hash},
    }


FIRST_WAIT_S = 5.0
WAIT_GROWS = 4.0
MOST_ATTEMPTS = 8
LEASE_S = 60.0  # no other server takes a message before this time is over
RECORDS_A_TURN = 200
MESSAGES_A_TURN = 5  # per webhook, so that none delays the others
LONGEST_OVERLAP_HOURS = 168.0
HOUR_S = 3600.0
TRIAL = "boresight.trial"
HEAD = "audit.head"


@dataclass(frozen=True)
class WebhookMessage:
    """A message to be sent: its address, secrets and content."""

    delivery_id: int
    webhook_id: int
    url: str
    body: str
    secrets: tuple[str, ...] = field(repr=False)


def judge_address(actor: Actor, url: str, targets: WebhookTargets) -> None:
    """Refuse an address that messages may not go to; this looks names up, so it comes before the writing transaction."""
    _require_administrator(actor)
    refuse_control_characters(url=url)
    refuse_address(url.strip(), targets)


def create_webhook(
    session: Session, actor: Actor, box: SecretBox, *, label: str, url: str, actions: Collection[str] = ()
) -> tuple[Webhook, str]:
    """Create a webhook for events from now on; return it and its secret, which is stored encrypted."""
    _require_administrator(actor)
    refuse_control_characters(label=label, url=url)
    if not label.strip():
        raise RefusedInputError("The webhook has no label; give one that names the receiver.")
    parsed(url.strip())
    secret = new_secret()
    row = Webhook(
        label=label.strip(),
        url=url.strip(),
        actions=sorted({_read_kind(action) for action in actions}),
        secret=box.seal(secret),
        told_audit_id=audit_rows.read_newest_id(session),
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.put(row)
    audit.append(session, actor, "created", _subject(row), None, _describe(row))
    row.told_audit_id = audit_rows.read_newest_id(session)
    return row, secret


def renew_secret(
    session: Session, actor: Actor, box: SecretBox, webhook_id: int, *, overlap_hours: float = 24.0
) -> tuple[Webhook, str]:
    """Give a webhook a new secret, and return both; the former one signs beside it for some hours more."""
    row = get_webhook(session, actor, webhook_id)
    if not 0.0 <= overlap_hours <= LONGEST_OVERLAP_HOURS:
        raise RefusedInputError(
            f"The previous secret cannot sign for that long; give 0 to {LONGEST_OVERLAP_HOURS:g} hours."
        )
    overlaps = overlap_hours > 0.0 and box.open(row.secret) is not None
    row.previous_secret = row.secret if overlaps else None
    row.previous_until_utc = utc_after(overlap_hours * HOUR_S) if overlaps else None
    secret = new_secret()
    row.secret = box.seal(secret)
    row.version += 1
    told_of = {"former_secret_until_utc": row.previous_until_utc}
    audit.append(session, actor, "renewed the secret of", _subject(row), None, told_of)
    return row, secret


def _read_kind(action: str) -> str:
    """Return the normalised name of a kind of event."""
    noun, dot, verb = action.strip().partition(".")
    if not (noun and dot and verb) or not action.strip().replace(".", "").replace("-", "").replace("*", "x").isalnum():
        raise RefusedInputError(
            f"{action!r} is not a kind of event; write it like parameter-sets.promoted or approvals.*.",
            code="unknown-event",
        )
    return action.strip()


def get_webhook(session: Session, actor: Actor, webhook_id: int) -> Webhook:
    """Return a webhook."""
    _require_administrator(actor)
    return session.get_known(Webhook, webhook_id)


def list_webhooks(session: Session, actor: Actor) -> Sequence[Webhook]:
    """Return every webhook, newest first."""
    _require_administrator(actor)
    return rows.list_webhooks(session)


def disable_webhook(session: Session, actor: Actor, webhook_id: int) -> Webhook:
    """Disable a webhook; its log stays."""
    row = get_webhook(session, actor, webhook_id)
    if row.disabled_utc is None:
        row.disabled_utc = utc_now()
        row.version += 1
        audit.append(session, actor, "disabled", _subject(row), {"disabled": False}, {"disabled": True})
    return row


def enable_webhook(session: Session, actor: Actor, webhook_id: int) -> Webhook:
    """Enable a webhook for events from now on, without those that happened meanwhile."""
    row = get_webhook(session, actor, webhook_id)
    if row.disabled_utc is not None:
        row.disabled_utc = None
        row.version += 1
        audit.append(session, actor, "enabled", _subject(row), {"disabled": True}, {"disabled": False})
        row.told_audit_id = audit_rows.read_newest_id(session)
    return row


def list_deliveries(
    session: Session, actor: Actor, webhook_id: int, *, before_id: int | None = None, limit: int | None = None
) -> Sequence[WebhookDelivery]:
    """Return a page of what was sent or is to be sent to a webhook, newest first."""
    get_webhook(session, actor, webhook_id)
    return lists.list_newest(session, WebhookDelivery, before_id=before_id, limit=limit, webhook=webhook_id)


def try_webhook(session: Session, actor: Actor, webhook_id: int) -> WebhookDelivery:
    """Queue a message that says nothing but that it came."""
    row = get_webhook(session, actor, webhook_id)
    _refuse_disabled(row)
    body = {"type": TRIAL, "at_utc": utc_now(), "object": _subject(row), "action": "tried", "actor": actor.printed_name}
    return _queue(session, row, None, {**body, "data": None})


def redeliver(session: Session, actor: Actor, delivery_id: int) -> WebhookDelivery:
    """Queue a message once more, as if it had never been tried; its id and its words stay."""
    _require_administrator(actor)
    delivery = session.get_known(WebhookDelivery, delivery_id)
    webhook = session.get_one(Webhook, delivery.webhook_id)
    _refuse_disabled(webhook)
    last = {name: getattr(delivery, name) for name in ("state", "attempts", "attempted_utc", "status", "outcome")}
    delivery.state, delivery.attempts, delivery.due_utc = "PENDING", 0, utc_now()
    audit.append(session, actor, "redelivered", _subject(webhook), last, {"message": make_message_id(delivery.id)})
    return delivery


def queue_new(session: Session) -> int:
    """Make messages from audit records that are new to webhooks; returns how many."""
    made = 0
    for webhook in rows.list_webhooks(session, enabled_only=True):
        for record in rows.list_records_after(session, webhook.told_audit_id, RECORDS_A_TURN):
            if _wants(webhook, name_kind(record)):
                _queue(session, webhook, record.id, make_message(record))
                made += 1
            webhook.told_audit_id = record.id
    return made


def is_any_due(session: Session, box: SecretBox) -> bool:
    """Whether this server has a message to deliver or to make."""
    return rows.is_any_untold(session) or bool(
        rows.list_due(session, utc_now(), 1, among=list_readable_ids(session, box))
    )


def is_head_told(session: Session, head: ExternalHead | None) -> bool:
    """Whether every webhook that subscribed to heads of the audit log has a message of this one."""
    return head is None or not _list_untold(session, head)


def tell_head(session: Session, head: ExternalHead) -> int:
    """Queue a message with a head of the audit log for each webhook that subscribed to heads; returns how many."""
    untold = _list_untold(session, head)
    content = {
        "type": HEAD,
        "at_utc": head.at_utc,
        "object": f"audit/{head.id}",
        "action": "head",
        "actor": "Boresight",
    }
    for webhook in untold:
        _queue(session, webhook, None, {**content, "data": {"id": head.id, "audit_hash": head.hash}})
        webhook.told_head = head.hash
    return len(untold)


def _list_untold(session: Session, head: ExternalHead) -> list[Webhook]:
    """Return the webhooks that subscribed to heads by name and have no message of this one."""
    named = (webhook for webhook in rows.list_webhooks(session, enabled_only=True) if HEAD in webhook.actions)
    return [webhook for webhook in named if webhook.told_head != head.hash]


def take_due(session: Session, limit: int, box: SecretBox) -> list[WebhookMessage]:
    """Claim due messages whose secret can be read here; they are not due again before their lease is over."""
    taken, now_utc = [], utc_now()
    readable = list_readable_ids(session, box)
    for delivery, webhook in rows.list_due(session, now_utc, limit, of_each=MESSAGES_A_TURN, among=readable):
        delivery.due_utc = utc_after(LEASE_S)
        former = webhook.previous_secret if (webhook.previous_until_utc or "") > now_utc else None
        opened = (box.open(stored) for stored in (webhook.secret, former))
        secrets = tuple(secret for secret in opened if secret is not None)
        taken.append(WebhookMessage(delivery.id, webhook.id, webhook.url, delivery.body, secrets))
    return taken


def settle(session: Session, delivery_id: int, *, status: int | None, outcome: str) -> None:
    """Record the outcome of an attempt: delivered, due again later, or given up; without any answer the whole webhook waits."""
    delivery = session.get_one(WebhookDelivery, delivery_id)
    delivery.attempts += 1
    delivery.attempted_utc, delivery.status, delivery.outcome = utc_now(), status, outcome
    if status is not None and 200 <= status < 300:
        delivery.state = "DELIVERED"
    elif delivery.attempts >= MOST_ATTEMPTS:
        delivery.state = "FAILED"
    else:
        delivery.state, delivery.due_utc = "PENDING", utc_after(FIRST_WAIT_S * WAIT_GROWS ** (delivery.attempts - 1))
    if status is None:
        until_utc = delivery.due_utc if delivery.state == "PENDING" else utc_after(FIRST_WAIT_S)
        rows.put_off(session, delivery.webhook_id, until_utc)


def _wants(webhook: Webhook, kind: str) -> bool:
    return not webhook.actions or kind in webhook.actions or f"{kind.partition('.')[0]}.*" in webhook.actions


def _queue(session: Session, webhook: Webhook, audit_id: int | None, content: dict[str, object]) -> WebhookDelivery:
    """Add a message that is due now, with its id in its content."""
    body = json.dumps({"id": make_message_id(rows.read_next_delivery_id(session)), **content}, ensure_ascii=False)
    delivery = WebhookDelivery(
        webhook_id=webhook.id, audit_id=audit_id, body=body, state="PENDING", due_utc=utc_now(), created_utc=utc_now()
    )
    return session.put(delivery)


def _describe(row: Webhook) -> dict[str, object]:
    """Describe a webhook for the audit log, without its secret."""
    return {"label": row.label, "url": row.url, "actions": row.actions}


def _refuse_disabled(row: Webhook) -> None:
    if row.disabled_utc is not None:
        raise ConflictError(
            f"The webhook {row.label!r} was disabled at {row.disabled_utc}; enable it first.", code="webhook-disabled"
        )


def _require_administrator(actor: Actor) -> None:
    """Require an administrator in person, because a webhook sends every event outside."""
    refuse_key(actor, "manage webhooks")
    require_role(actor, "administrator")


def _subject(row: Webhook) -> str:
    return f"webhooks/{row.id}"
