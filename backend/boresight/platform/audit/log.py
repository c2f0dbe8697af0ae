"""The audit log: append-only, hash-chained, with a seal on every row that it covers.

`boresight.platform.audit.chain` says how records are chained, `boresight.platform.audit.seals` what a seal is. Changing, removing,
reordering or renumbering a record breaks the chain at that record; changing, removing or inserting a sealed row by hand leaves it
without its seal. The log is tamper-evident, not tamper-proof: whoever owns the database can rebuild it from any point,
and can cut its tail unseen where no row was sealed in it, unless someone outside holds a later head. So every export
carries the head, and `verify` takes a head that must still be there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from boresight.errors import NotFoundError
from boresight.platform.actors import Actor
from boresight.platform.audit import chain, verification
from boresight.platform.audit import queries as rows
from boresight.platform.audit.anchors import AnchorFindings, TrustedKeys, tell_coverage, verify_anchors
from boresight.platform.audit.external_head import ExternalHead
from boresight.platform.audit.tables import AuditAnchor, AuditRecord
from boresight.platform.audit.verification import RowMismatch, VerificationFindings
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.lists import list_newest_rows
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import read_time

FIRST_HASH = chain.FIRST_HASH
BAD_FILES_NAMED = 20
HEAD_KEPT, HEAD_FILE = "head kept", "audit-head"  # action and object of the record that heads are kept in a file


@dataclass(frozen=True)
class ChainReport:
    """What a verification found."""

    ok: bool
    records: int
    head: str
    first_broken_id: int | None
    sentence: str
    rows: int = 0
    first_broken_row: str | None = None
    last_id: int = 0
    files: int = 0
    bad_files: tuple[str, ...] = ()
    anchors: int = 0
    time_stamped: int = 0
    anchored_id: int = 0
    anchored_utc: str | None = None


def append(
    session: Session,
    actor: Actor,
    action: str,
    subject: str,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
    reason: str | None = None,
) -> AuditRecord:
    """Put one record at the end of the chain; it is written with the commit of the caller's transaction."""
    session.flush()
    return chain.append(
        session,
        actor_id=actor.user_id,
        actor=actor.printed_name,
        credential=actor.credential,
        action=str(action),
        object=subject,
        before=None if before is None else dict(before),
        after=None if after is None else dict(after),
        reason=reason,
        request_id=actor.request_id,
        roles=sorted(actor.roles),
    )


def find_newest_head(session: Session) -> ExternalHead | None:
    """Return number, hash and time of the newest record, for the external file; None where there is none."""
    newest = next(iter(list_newest_rows(session, rows.RECORDS, limit=1)), None)
    return None if newest is None else ExternalHead(newest.id, newest.hash, newest.at_utc)


def holds(session: Session, kept: ExternalHead) -> bool:
    """Whether the record of a kept head exists unchanged."""
    record = rows.record(session, kept.id)
    return record is not None and record.hash == kept.hash


def head_was_kept(session: Session, file: Path) -> bool:
    """Whether the log records that heads are kept in a file, which must exist from then on."""
    told = list_newest_rows(session, rows.RECORDS, object=HEAD_FILE, action=HEAD_KEPT)
    return any((record.after or {}).get("file") == str(file.absolute()) for record in told)


def tell_head_kept(session: Session, file: Path) -> None:
    """Record that heads are kept in a file, so that verification notices when it is gone."""
    chain.append_own(session, HEAD_KEPT, HEAD_FILE, after={"file": str(file.absolute())})


def head(session: Session) -> str:
    """Return the head of the chain, to be carried by exports."""
    chain.write_out(session)
    return chain.head(session)


def find_last_change(session: Session, subject: str) -> AuditRecord | None:
    """Return the newest record about an object."""
    return rows.find_last_change(session, subject)


def list_records(
    session: Session,
    *,
    before_id: int | None = None,
    subject: str | None = None,
    sought: Mapping[str, str | None] | None = None,
    limit: int | None = None,
) -> Sequence[AuditRecord]:
    """Return a page of records, newest first; the next page starts before the last one's id."""
    return list_newest_rows(session, rows.RECORDS, before_id=before_id, limit=limit, **(sought or {"object": subject}))


def list_anchors(session: Session, *, before_id: int | None = None, limit: int | None = None) -> Sequence[AuditAnchor]:
    """Return a page of anchors, newest first."""
    return list_newest_rows(session, rows.ANCHORS, before_id=before_id, limit=limit)


def get_record(session: Session, record_id: int) -> AuditRecord:
    """Return a record."""
    record = rows.record(session, record_id)
    if record is None:
        raise NotFoundError(f"There is no audit record {record_id}; choose one from the list.")
    return record


def read_words(session: Session) -> tuple[Sequence[str], Sequence[str]]:
    """Return recent actors and actions, as choices for filters."""
    return rows.read_words(session)


def sought(
    *,
    object: str | None = None,  # noqa: A002 - the name of the column
    actor: str | None = None,
    action: str | None = None,
    since: str | None = None,
    until: str | None = None,
) -> Mapping[str, str | None]:
    """Return the filters of a list of records; times in ISO 8601, UTC where they name no zone."""
    return {
        "object": object,
        "actor": actor,
        "action": action,
        "since_utc": _time(since),
        "until_utc": _time(until),
    }


def _time(text: str | None) -> str | None:
    return None if text is None else read_time(text)


def verify(
    session: Session,
    expected_head: str | None = None,
    blobs: BlobStore | None = None,
    *,
    kept: ExternalHead | None = None,
    head_file: Path | None = None,
    again: bool = True,
    trust: TrustedKeys | None = None,
) -> ChainReport:
    """Verify the whole chain, every sealed row, journal, anchor and stored file, and report the first that was altered."""
    found = verification.verify(session, expected_head, None if kept is None else kept.hash)
    looked_at = [] if blobs is None else list(files.bad_files(session, blobs, again=again))
    bad = [str(one) for one in looked_at if one is not None]
    misfit = found.misfit or next(iter(found.guards), None) if found.broken_id is None else None
    absent = head_file if kept is None else None
    is_lost = absent is not None and head_was_kept(session, absent)
    anchored = AnchorFindings() if trust is None else verify_anchors(session, trust)
    broken_id = found.broken_id if misfit is None else misfit.record_id
    return ChainReport(
        ok=found.ok and not bad and not is_lost and not anchored.fault,
        records=found.records,
        head=found.head,
        first_broken_id=broken_id,
        sentence=_sentence(found, kept, None if blobs is None else len(looked_at), bad)
        + ("" if absent is None else _absence(absent, is_lost=is_lost))
        + ("" if trust is None else f" {tell_coverage(anchored, found.last_id, some=trust.newest is not None)}"),
        rows=found.rows,
        first_broken_row=None if misfit is None else misfit.row,
        last_id=found.last_id,
        files=len(looked_at),
        bad_files=tuple(bad[:BAD_FILES_NAMED]),
        anchors=anchored.anchors,
        time_stamped=anchored.stamped,
        anchored_id=anchored.record_id,
        anchored_utc=anchored.at_utc,
    )


def _sentence(found: VerificationFindings, kept: ExternalHead | None, looked_at: int | None, bad: Sequence[str]) -> str:
    """Return the worst finding as a sentence."""
    count = found.records
    if found.broken_id is not None:
        return (
            f"Record {found.broken_id} was altered or renumbered, or an earlier record was removed; the {count} records before it "
            "are intact."
        )
    if found.misfit is None and found.unmet:
        lost = (
            f": record {kept.id}, which was written before {kept.at_utc}" if kept and kept.hash in found.unmet else ""
        )
        what = "truncated or rewritten" if lost else "rewritten"
        return (
            f"The chain of {count} records is intact, but the head {found.unmet[0]} is not in it{lost}: the log was {what}, or "
            "restored from an older disk state."
        )
    if (misfit := found.misfit or next(iter(found.guards), None)) is not None:
        others = max(0, found.misfits - 1) + len(found.guards[0 if found.misfit else 1 :])
        more = f", and {others} more do{'' if others > 1 else 'es'} not match the log" if others else ""
        return (
            f"{_capital(_where(misfit))}{misfit.row} was {misfit.what} outside Boresight{more}; "
            f"the chain of {count} records itself is intact."
        )
    if bad:
        more = f", and {len(bad) - 1} more" if len(bad) > 1 else ""
        return (
            f"The stored file {bad[0]}{more}: restore it from a backup. All {count} records and {found.rows} sealed rows are "
            "intact."
        )
    stored = "" if looked_at is None else f", {looked_at} stored file{'s' * (looked_at != 1)}"
    return f"All {count} records{stored} and {found.rows} sealed rows are intact."


def _absence(file: Path, *, is_lost: bool) -> str:
    """Return the sentence for a missing external head."""
    if not is_lost:
        return f" No head was stored in {file} yet, so it is not known whether newer records were lost."
    return (
        f" But {file} contains no head although it had some before, so records may have been lost: mount its disk or restore the "
        "file; if it cannot be restored, find out why and set another file in BORESIGHT_AUDIT_HEAD_FILE."
    )


def _where(misfit: RowMismatch) -> str:
    if misfit.record_id is not None:
        return f"the seal in record {misfit.record_id} does not match: "
    return "no record created it: " if misfit.what == "inserted" and "/" in misfit.row else ""


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
