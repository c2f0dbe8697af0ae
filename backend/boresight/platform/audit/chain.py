"""The chain of audit records, and the seals in it.

With `canon` the canonical JSON of a record's columns except `id`, `previous_hash` and `hash`, `rows` and `roles` left
out where they are NULL::

    id_0 = 0,            id_n = id_(n-1) + 1
    hash_0 = 64 zeros,   hash_n = SHA-256(hash_(n-1) || canon(record_n))

The number is outside the hash, so it must follow: the one writer at a time gives it, and a record that was renumbered,
with all after it or alone, does not follow the one before. Records of before there were seals, which alone have no
`roles`, were numbered by the database, whose sequence skips a number when a transaction of PostgreSQL's is undone: a
gap is let pass before such a record, and before no other.

A record waits in its session until the transaction commits. Then the digests of every sealed row that the transaction touched,
and the newest hash of every journal that has grown, go into `rows` of its last record, and the records are written in their
order. This hangs on the session's own commit, so no code that writes through a session can go round it; a transaction that
touched a sealed row and appended no record at all is refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from json.encoder import encode_basestring
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import ORMExecuteState, Session

from boresight.platform.audit import seals as journals
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.documents import canonical
from boresight.platform.db.times import seconds_between, utc_now

FIRST_HASH = "0" * 64
TEXTS = ("at_utc", "actor", "credential", "action", "object", "reason", "request_id")
DOCUMENTS = ("before", "after", "rows", "roles")
NUMBERS = ("id", "actor_id")
COLUMNS = (*NUMBERS, *TEXTS, *DOCUMENTS, "previous_hash", "hash")
HASHED = tuple(sorted({*COLUMNS} - {"id", "previous_hash", "hash"}))  # sorted as canonical JSON sorts its keys
LEFT_OUT_WHEN_NULL = ("rows", "roles")  # absent from records written before seals existed
SET_BACK_S = 2.0
PENDING = "audit records that wait for the commit"
WRITTEN = "audit records were written"


def compute_hash(previous_hash: str, raw: Mapping[str, Any]) -> str:
    """Return the hash that chains a record to the one before."""
    parts = [
        f'"{name}":{_value(name, raw[name])}'
        for name in HASHED
        if name not in LEFT_OUT_WHEN_NULL or raw[name] is not None
    ]
    return hashlib.sha256(f"{previous_hash}{{{','.join(parts)}}}".encode()).hexdigest()


def follows(last_id: int, previous_hash: str, raw: Mapping[str, Any]) -> bool:
    """Whether a record, given by its stored columns, follows the one with this number and hash."""
    skipped = raw["roles"] is None and raw["id"] > last_id  # written before seals existed
    numbered = raw["id"] == last_id + 1 or skipped
    return numbered and raw["previous_hash"] == previous_hash and raw["hash"] == compute_hash(previous_hash, raw)


def spelled(raw: Mapping[str, Any]) -> str:
    """Return a whole record as canonical JSON, for exports."""
    return f"{{{','.join(f'{encode_basestring(name)}:{_value(name, raw[name])}' for name in sorted(COLUMNS))}}}"


def _value(name: str, value: Any) -> str:
    """Spell a column's value as canonical JSON does; a document is stored in that spelling."""
    if value is None:
        return "null"
    return str(value) if name in NUMBERS or name in DOCUMENTS else encode_basestring(value)


def append(session: Session, *, roles: Sequence[str], **values: Any) -> AuditRecord:
    """Queue a record for the commit of its transaction; `at_utc` is now, `roles` may be empty and is never NULL."""
    record = AuditRecord(at_utc=utc_now(), roles=list(roles), **values)
    session.info.setdefault(PENDING, []).append(record)
    return record


def append_own(session: Session, action: str, subject: str, **values: Any) -> AuditRecord:
    """Queue a record of an action by Boresight itself for the commit."""
    return append(
        session, actor="Boresight", credential="system", action=str(action), object=subject, roles=[], **values
    )


def pending(session: Session) -> list[AuditRecord]:
    """Return the records that wait for the commit, in their order."""
    return list(session.info.get(PENDING, ()))


def write_out(session: Session) -> None:
    """Write the waiting records, the last one with the digests of every row touched so far."""
    records = session.info.pop(PENDING, None)
    if not records:
        return
    if (back := _ran_back(session, records[0].at_utc)) is not None:
        records.insert(0, back)
    records[-1].rows = {**journals.take(session), **journals.heads(session)} or None
    last_id, previous = newest(session)
    for record_id, record in enumerate(records, start=last_id + 1):
        record.id, record.previous_hash = record_id, previous
        record.hash = previous = compute_hash(previous, _raw(record))
        session.add(record)
    session.flush()
    session.info[WRITTEN] = True


def _ran_back(session: Session, at_utc: str) -> AuditRecord | None:
    """Return a record that the clock ran backwards since the newest record by more than an ordinary correction; None otherwise."""
    before = session.scalar(sa.select(AuditRecord.at_utc).order_by(AuditRecord.id.desc()).limit(1))
    try:
        set_back_s = 0.0 if before is None else seconds_between(at_utc, before)
    except (ValueError, TypeError):  # a time edited by hand is reported by verification and must not stop writing
        return None
    if set_back_s <= SET_BACK_S:
        return None
    return AuditRecord(
        at_utc=at_utc,
        actor="Boresight",
        credential="system",
        action="clock ran backwards",
        object="clock",
        before={"at_utc": before},
        after={"at_utc": at_utc},
        reason=f"The clock was set back by {set_back_s:.0f} s since the previous record.",
        roles=[],
    )


def write_before_reading(state: ORMExecuteState) -> None:
    """Write the waiting records, so that a query of the log sees those of its own transaction."""
    if state.session.info.get(PENDING) and state.is_select and sa.inspect(AuditRecord) in state.all_mappers:
        write_out(state.session)


def _raw(record: AuditRecord) -> dict[str, Any]:
    """Return a record's hashed columns as they will be stored."""
    values = {name: getattr(record, name) for name in HASHED}
    return values | {name: canonical(values[name]) for name in DOCUMENTS if values[name] is not None}


def newest(session: Session) -> tuple[int, str]:
    """Return number and hash of the newest record that is written; 0 and `FIRST_HASH` where there is none."""
    query = sa.select(AuditRecord.id, AuditRecord.hash).order_by(AuditRecord.id.desc()).limit(1)
    found = session.execute(query).first()
    return (0, FIRST_HASH) if found is None else (found.id, found.hash)


def head(session: Session) -> str:
    """Return the hash of the newest record that is written."""
    return newest(session)[1]


def seal(session: Session) -> None:
    """Write the waiting records before a commit."""
    session.flush()
    noted = session.info.get(journals.NOTED)
    if noted and not pending(session):
        if not session.info.get(WRITTEN):
            raise ValueError(f"Expected an audit record of the change / Received none for {_named(noted)}")
        append_own(session, "sealed", "audit")
    write_out(session)
    session.info.pop(WRITTEN, None)


def _named(noted: Mapping[Any, Any]) -> str:
    return ", ".join(f"{model.__tablename__}/{row_id}" for model, ids in noted.items() for row_id in sorted(ids))


def forget(session: Session) -> None:
    """Discard what was to be written and sealed, after a rollback."""
    for name in (PENDING, WRITTEN, journals.NOTED):
        session.info.pop(name, None)
    journals.forget(session)


def seal_everything(session: Session) -> None:
    """Seal every existing row under records of their own, once, in a database from before seals existed."""
    for model in journals.list_sealed():
        key = model.__table__.columns["id"]
        for some in journals.portions(session.scalars(sa.select(key).order_by(key)).all()):
            for row_id in some:
                journals.note(session, model, row_id)
            append_own(session, "sealed", model.__tablename__, after={"rows": len(some)})
            write_out(session)
