"""The audit log: append-only, hash-chained, and a seal on every row that it tells of.

`boresight.store.chain` says how records are chained, `boresight.store.seals` what a seal is. Changing, removing,
reordering or renumbering a record breaks the chain at that record; changing, removing or inserting a sealed row by hand leaves it
without its seal. The log is tamper-evident, not tamper-proof: whoever owns the database can rebuild it from any point,
and can cut its tail unseen where no row was sealed in it, unless someone outside holds a later head. So every export
carries the head, and `verify` takes a head that must still be there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.errors import NotFoundError
from boresight.services.actors import Actor
from boresight.store import audit as rows
from boresight.store import chain, verification
from boresight.store.audit import Sought
from boresight.store.sessions import Session
from boresight.store.tables import AuditRecord
from boresight.store.times import read_time
from boresight.store.verification import Findings

FIRST_HASH = chain.FIRST_HASH


@dataclass(frozen=True)
class ChainReport:
    """What a verification found.

    Parameters
    ----------
    ok
        Whether every record and every sealed row is as it was written, and the expected head is in the chain.
    records
        How many records were found good, from the first on.
    head
        Hash of the last good record.
    first_broken_id
        The first record that is not as it was written, or whose row is not as it left it; None when all are.
    sentence
        The finding in words.
    rows
        How many sealed rows were held against the chain.
    first_broken_row
        The row that is not as the chain has it, as `table/id`; None when all are.
    last_id
        Number of the last good record.
    """

    ok: bool
    records: int
    head: str
    first_broken_id: int | None
    sentence: str
    rows: int = 0
    first_broken_row: str | None = None
    last_id: int = 0


def append(
    session: Session,
    actor: Actor,
    action: str,
    subject: str,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
    reason: str | None = None,
) -> AuditRecord:
    """Put one record at the end of the chain; it is written with the commit of the caller's transaction.

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
    session.flush()
    return chain.append(
        session,
        actor_id=actor.user_id,
        actor=actor.printed_name,
        credential=actor.credential,
        action=action,
        object=subject,
        before=None if before is None else dict(before),
        after=None if after is None else dict(after),
        reason=reason,
        request_id=actor.request_id,
        roles=sorted(actor.roles),
    )


def head(session: Session) -> str:
    """Return the head of the chain, to be carried by exports."""
    chain.write_out(session)
    return chain.head(session)


def last_change(session: Session, subject: str) -> AuditRecord | None:
    """Return who last changed an object, as its newest record."""
    return rows.last_change(session, subject)


def list_records(
    session: Session,
    *,
    before_id: int | None = None,
    subject: str | None = None,
    sought: Sought | None = None,
    limit: int = 100,
) -> Sequence[AuditRecord]:
    """Return a page of records, newest first; the next page starts before the last one's id."""
    return rows.records(session, before_id=before_id, sought=sought or Sought(object=subject), limit=limit)


def get_record(session: Session, record_id: int) -> AuditRecord:
    """Return a record.

    Raises
    ------
    NotFoundError
        When there is none with this number.
    """
    record = rows.record(session, record_id)
    if record is None:
        raise NotFoundError(f"There is no audit record {record_id}.")
    return record


def words(session: Session) -> tuple[Sequence[str], Sequence[str]]:
    """Return who acted and what was done lately, to choose from."""
    return rows.words(session)


def sought(
    *,
    object: str | None = None,  # noqa: A002 - the name of the column
    actor: str | None = None,
    action: str | None = None,
    since: str | None = None,
    until: str | None = None,
) -> Sought:
    """Say what a list of records is narrowed to; times in ISO 8601, UTC where they name no zone.

    Raises
    ------
    RefusedInputError
        When a time cannot be read.
    """
    return Sought(object, actor, action, _time(since), _time(until))


def _time(text: str | None) -> str | None:
    """Read a time as the store writes it."""
    return None if text is None else read_time(text)


def verify(session: Session, expected_head: str | None = None) -> ChainReport:
    """Walk the whole chain and every sealed row, and name the first that is not as it was written.

    Parameters
    ----------
    expected_head
        A head from an earlier export; not finding it means that the tail was cut and rewritten.
    """
    found = verification.verify(session, expected_head)
    misfit = found.misfit
    broken_id = found.broken_id if misfit is None else misfit.record_id
    return ChainReport(
        ok=found.broken_id is None and misfit is None and found.met,
        records=found.records,
        head=found.head,
        first_broken_id=broken_id,
        sentence=_sentence(found, expected_head),
        rows=found.rows,
        first_broken_row=None if misfit is None else misfit.row,
        last_id=found.last_id,
    )


def _sentence(found: Findings, expected_head: str | None) -> str:
    """Say in words what was found, the worst of it."""
    count = found.records
    if found.broken_id is not None:
        return (
            f"Record {found.broken_id} is not as it was written, or it was renumbered, or one before it was removed; "
            f"{count} before it are."
        )
    if found.misfit is not None:
        more = f", and {found.misfits - 1} more are not as they were written" if found.misfits > 1 else ""
        where = f"Record {found.misfit.record_id} sealed it otherwise"
        if found.misfit.record_id is None:
            where = "no record put it there"
        return (
            f"{_capital(where)}: {found.misfit.row} was {found.misfit.what} outside Boresight{more}; "
            f"the chain of {count} records itself holds together."
        )
    if not found.met:
        return (
            f"The chain of {count} records holds together, but the head {expected_head} is not in it: it was rewritten."
        )
    return f"All {count} records and the {found.rows} rows that they sealed are as they were written."


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
