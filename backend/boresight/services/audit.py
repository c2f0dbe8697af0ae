"""The audit log: append-only and hash-chained.

With `canon` the canonical JSON of a record's columns except `id`, `previous_hash` and `hash`::

    hash_0 = 64 zeros,   hash_n = SHA-256(hash_(n-1) || canon(record_n))

Changing, removing or reordering a record breaks the chain at that record. The chain is tamper-evident, not
tamper-proof: whoever owns the database can rebuild it from any point, and can cut its tail unseen, unless someone
outside holds a later head. So every export carries the head, and `verify` takes a head that must still be there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.services.actors import Actor
from boresight.store import audit as rows
from boresight.store.documents import canonical
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import AuditRecord

FIRST_HASH = "0" * 64
HASHED = ("at_utc", "actor_id", "actor", "credential", "action", "object", "before", "after", "reason", "request_id")


@dataclass(frozen=True)
class ChainReport:
    """What a walk along the chain found.

    Parameters
    ----------
    ok
        Whether every record is as it was written and the expected head is among them.
    records
        How many records were found good, from the first on.
    head
        Hash of the last good record.
    first_broken_id
        The first record that is not as it was written; None when all are.
    sentence
        The finding in words.
    """

    ok: bool
    records: int
    head: str
    first_broken_id: int | None
    sentence: str


def append(
    session: Session,
    actor: Actor,
    action: str,
    subject: str,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
    reason: str | None = None,
) -> AuditRecord:
    """Write one record at the end of the chain, in the caller's transaction.

    Parameters
    ----------
    action
        What happened, in the past: `submitted`, `promoted`, `was disabled`.
    subject
        What it happened to, as its REST address: `parameter-sets/3`.
    before, after
        What changed, as JSON documents; None where there was nothing.
    reason
        In the actor's words.
    """
    last = rows.last_record(session)
    record = AuditRecord(
        at_utc=utc_now(),
        actor_id=actor.user_id,
        actor=actor.printed_name,
        credential=actor.credential,
        action=action,
        object=subject,
        before=None if before is None else dict(before),
        after=None if after is None else dict(after),
        reason=reason,
        request_id=actor.request_id,
        previous_hash=FIRST_HASH if last is None else last.hash,
    )
    record.hash = _hash(record, record.previous_hash)
    session.add(record)
    session.flush()
    return record


def _hash(record: AuditRecord, previous_hash: str) -> str:
    """Compute the hash that chains a record to the one before."""
    content = canonical({name: getattr(record, name) for name in HASHED})
    return hashlib.sha256((previous_hash + content).encode()).hexdigest()


def head(session: Session) -> str:
    """Return the head of the chain, to be carried by exports."""
    last = rows.last_record(session)
    return FIRST_HASH if last is None else last.hash


def last_change(session: Session, subject: str) -> AuditRecord | None:
    """Return who last changed an object, as its newest record."""
    return rows.last_change(session, subject)


def list_records(
    session: Session, *, before_id: int | None = None, subject: str | None = None, limit: int = 100
) -> Sequence[AuditRecord]:
    """Return a page of records, newest first; the next page starts before the last one's id."""
    return rows.records(session, before_id=before_id, subject=subject, limit=limit)


def verify(session: Session, expected_head: str | None = None) -> ChainReport:
    """Walk the whole chain and name the first record that is not as it was written.

    Parameters
    ----------
    expected_head
        A head from an earlier export; not finding it means that the tail was cut and rewritten.
    """
    previous, count, met = FIRST_HASH, 0, expected_head in (None, FIRST_HASH)
    for record in rows.walk(session):
        if record.previous_hash != previous or record.hash != _hash(record, previous):
            sentence = (
                f"Record {record.id} is not as it was written, or one before it was removed; {count} before it are."
            )
            return ChainReport(ok=False, records=count, head=previous, first_broken_id=record.id, sentence=sentence)
        previous, count, met = record.hash, count + 1, met or record.hash == expected_head
    if not met:
        sentence = (
            f"The chain of {count} records holds together, but the head {expected_head} is not in it: it was rewritten."
        )
        return ChainReport(ok=False, records=count, head=previous, first_broken_id=None, sentence=sentence)
    sentence = f"All {count} records are as they were written."
    return ChainReport(ok=True, records=count, head=previous, first_broken_id=None, sentence=sentence)
