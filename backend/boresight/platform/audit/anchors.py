"""Anchors: heads of the audit log that the installation signed, so that the owner of the database cannot rebuild the chain unseen.

With `canon` canonical JSON and k the signing key (`boresight.platform.audit.signing`)::

    statement = canon({"schema": "boresight.audit-anchor/1", "record": n, "head": hash_n, "at_utc", "made_by", "key": id(k)})
    signature = Ed25519(k, statement)
    time-stamp = RFC 3161(SHA-256(signature))        where a service is set

As hash_n covers every record up to n, an anchor covers them all. Whoever rewrites a record needs k to sign the new chain, and with
a time-stamp the service's key too, to make believe that it was so before. Anchors are a journal: one that is removed or moved
meets the audit log. The newest ones can be cut together with the records after them, as the end of any log; keep one elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from boresight.errors import ConflictError
from boresight.platform.audit import chain
from boresight.platform.audit import queries as rows
from boresight.platform.audit.signing import PublicKey, SigningKey
from boresight.platform.audit.tables import AuditAnchor
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import utc_now

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

    from boresight.platform.audit.time_stamps import TimeStamp

SCHEMA = "boresight.audit-anchor/1"


@dataclass(frozen=True)
class TrustedKeys:
    """The keys that may sign anchors, their source, and the authorities of time-stamps; `newest` limits how many are read."""

    keys: Sequence[PublicKey]
    source: str
    authorities: tuple[Certificate, ...] = ()
    newest: int | None = None


@dataclass
class AnchorFindings:
    """What a verification of the anchors found."""

    anchors: int = 0
    stamped: int = 0
    record_id: int = 0
    at_utc: str | None = None
    stamped_utc: str | None = None
    unknown: list[str] = field(default_factory=list)
    fault: str = ""


def spell_statement(anchor: AuditAnchor) -> bytes:
    """Return what the signature of an anchor is of."""
    said = {
        "schema": SCHEMA,
        "record": anchor.record_id,
        "head": anchor.head,
        "at_utc": anchor.at_utc,
        "made_by": anchor.made_by,
        "key": anchor.key,
    }
    return canonical(said).encode()


def spell_line(anchor: AuditAnchor) -> str:
    """Return an anchor as a line of an export: what is signed, its signature and key, and its time-stamp."""
    beside = {"public_key": anchor.public_key, "signature": anchor.signature}
    stamp = {"time_stamp": anchor.time_stamp, "stamped_utc": anchor.stamped_utc} if anchor.time_stamp else {}
    return canonical(json.loads(spell_statement(anchor)) | beside | stamp)


def make_anchor(session: Session, key: SigningKey, made_by: str) -> AuditAnchor:
    """Sign the newest head, or return the anchor that covers it already."""
    chain.write_out(session)
    record_id, head = chain.newest(session)
    if not record_id:
        raise ConflictError("The audit log is empty: add a person first, which is its first record.")
    signer = key.load()
    newest, public = rows.find_newest_anchor(session), signer.public.text
    if newest is not None and (newest.head, newest.public_key) == (head, public):
        return newest
    anchor = AuditAnchor(
        record_id=record_id, head=head, at_utc=utc_now(), made_by=made_by, public_key=public, signature=""
    )
    anchor.signature = signer.sign(spell_statement(anchor))
    session.put(anchor)
    return anchor


def keep_time_stamp(session: Session, anchor_id: int, stamp: TimeStamp) -> None:
    """Keep the time-stamp of an anchor."""
    anchor = session.get_known(AuditAnchor, anchor_id)
    anchor.time_stamp, anchor.stamped_utc = stamp.text, stamp.at_utc


def verify_anchors(session: Session, trust: TrustedKeys) -> AnchorFindings:
    """Verify the anchors against the log, the keys and the authorities; that the log itself is intact is verified beside this."""
    found = AnchorFindings()
    known = {key.text for key in trust.keys}
    for anchor, head in rows.iterate_anchors(session, trust.newest):
        found.anchors += 1
        if anchor.public_key not in known:
            found.unknown.append(anchor.key)
            continue
        if fault := _find_fault(anchor, head, trust.authorities):
            found.fault = found.fault or f"Anchor {anchor.id} of record {anchor.record_id} {fault}"
            continue
        found.record_id, found.at_utc = max(found.record_id, anchor.record_id), anchor.at_utc
        if anchor.time_stamp is not None and trust.authorities:
            found.stamped, found.stamped_utc = found.stamped + 1, anchor.stamped_utc
    if found.unknown and not found.fault:
        names = ", ".join(dict.fromkeys(found.unknown))
        found.fault = (
            f"{len(found.unknown)} of {found.anchors} anchors are signed by keys that are not in {trust.source} ({names}): add "
            "those keys with `boresight audit trust`, or find out who signed."
        )
    return found


def _find_fault(anchor: AuditAnchor, head: str | None, authorities: tuple[Certificate, ...]) -> str:
    """Return what is wrong with an anchor of a known key, empty where nothing is."""
    if not PublicKey.decode(anchor.public_key).verifies(anchor.signature, spell_statement(anchor)):
        return "was changed since it was signed: find out who edits the database."
    if head != anchor.head:
        return "does not match the chain: the records up to there were rewritten or removed after it was signed."
    if anchor.time_stamp is None or not authorities:
        return ""
    from boresight.platform.audit.time_stamps import read_time_stamp  # noqa: PLC0415 - only where a service is set

    if read_time_stamp(anchor.time_stamp, anchor.signature.encode(), authorities) != anchor.stamped_utc:
        return "has a time-stamp that is not valid: check the certificates of the service, and who edits the database."
    return ""


def tell_coverage(found: AnchorFindings, last_id: int, *, some: bool = False) -> str:
    """Return a sentence on what the anchors cover of a log."""
    if found.fault:
        return found.fault
    if not found.anchors:
        return "No anchor covers the log yet."
    one = found.anchors == 1
    count = (
        "The newest anchor"
        if some and one
        else f"{'The newest ' if some else ''}{found.anchors} anchor{'s' * (not one)}"
    )
    stamped = f", {found.stamped} of them time-stamped," if found.stamped else ""
    after = last_id - found.record_id
    later = "1 later record is" if after == 1 else f"{after} later records are"
    rest = f"; {later} not covered yet" if after > 0 else ", the newest"
    return f"{count}{stamped} cover{'s' * one} the records up to {found.record_id}{rest}."
