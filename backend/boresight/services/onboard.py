"""An entry about a set on board: who may make one, and what it rests on. Entries are only ever added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from boresight.errors import ConflictError, RefusedInputError
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope, require_user
from boresight.services.parameter_sets import get_parameter_set
from boresight.services.transitions import require_seen, subject_of
from boresight.services.watch import watch
from boresight.services.words import refuse_control_characters
from boresight.store import uplinks as rows
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import ParameterSet, Uplink


@dataclass(frozen=True)
class Basis:
    """What an entry rests on; nothing but its source makes it a statement.

    Parameters
    ----------
    evidence
        What goes with it as a document: the package, the dump and what was found in it, when it happened.
    method
        How a read-back was compared: `bytes` or `crc`.
    printed_name, meaning
        Of who signed it, and what the signature means.
    """

    evidence: Mapping[str, Any] = field(default_factory=dict)
    method: str | None = None
    printed_name: str | None = None
    meaning: str | None = None


STATEMENT = Basis()


def set_for_entry(
    session: Session, actor: Actor, parameter_set_id: int, source: str, seen_version: int | None
) -> ParameterSet:
    """Return the set that an operator makes an entry for.

    Raises
    ------
    ForbiddenError
        When the actor is no operator, or nobody who answers for it.
    StaleError
        When the set changed since the version that was seen.
    RefusedInputError
        When no source is given.
    """
    require_role(actor, "operator")
    require_scope(actor, "uplinks")
    require_user(actor, "record an uplink")
    refuse_control_characters(source=source)
    row = get_parameter_set(session, parameter_set_id)
    if seen_version is not None:
        require_seen(session, row, seen_version)
    if not source.strip():
        raise RefusedInputError("Say where this is known from: the pass, the procedure or the read-back file.")
    return row


def shown_mismatch(session: Session, row: ParameterSet) -> bool:
    """Say whether a dump of what was last sent differed, and no dump has agreed since.

    What was recorded in between, by statement or by CRC, changes nothing of it: of all that was recorded since the set was
    last SENT only the comparisons of bytes count, and the newest of them decides.
    """
    sent = rows.newest_record(session, row.id, "SENT")
    compared = rows.newest_compared(session, row.id, "bytes", 0 if sent is None else sent.id)
    return compared is not None and compared.onboard_state == "MISMATCH"


def refuse_shown_mismatch(session: Session, row: ParameterSet) -> None:
    """Refuse what would take back, without bytes, a mismatch that bytes showed.

    Raises
    ------
    ConflictError
        When a mismatch stands.
    """
    if shown_mismatch(session, row):
        raise ConflictError(
            f"A dump of {row.name} showed the mismatch; upload a dump that matches, or send the table again."
        )


def add_entry(
    session: Session, actor: Actor, row: ParameterSet, onboard_state: str, source: str, basis: Basis = STATEMENT
) -> Uplink:
    """Add the entry and show its state on the set, with one audit record."""
    uplink = Uplink(
        parameter_set_id=row.id,
        onboard_state=onboard_state,
        source=source.strip(),
        recorded_utc=utc_now(),
        recorded_by=require_user(actor, "record an uplink"),
        method=basis.method,
        evidence=dict(basis.evidence) or None,
        printed_name=basis.printed_name,
        meaning=basis.meaning,
    )
    before = {"onboard_state": row.onboard_state, "version": row.version}
    row.onboard_state = onboard_state
    row.version += 1
    session.add(uplink)
    session.flush()
    told = {"method": basis.method, "meaning": basis.meaning, "found": basis.evidence.get("sentence")}
    after = {"onboard_state": onboard_state, "version": row.version, "record": f"uplinks/{uplink.id}"}
    after |= {name: value for name, value in told.items() if value is not None}
    audit.append(session, actor, f"recorded {onboard_state} for", subject_of(row), before, after, source.strip())
    watch(session, [row.sensor_id])
    return uplink
