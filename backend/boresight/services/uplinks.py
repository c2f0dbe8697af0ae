"""What is on board, as people recorded it; Boresight commands no spacecraft.

    NOT SENT --> SENT --> LOADED --> VERIFIED --> ACTIVE

One step at a time, each with its source. ACTIVE therefore always follows a verified read-back. MISMATCH and UNKNOWN can
be recorded for anything that was sent, and are left by sending again or by a read-back. One set is active: when another
is recorded as ACTIVE, the one before becomes UNKNOWN.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from boresight.errors import ConflictError, RefusedInputError
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope, require_user
from boresight.services.parameter_sets import get_parameter_set
from boresight.services.transitions import require_seen, subject_of
from boresight.services.words import refuse_control_characters
from boresight.store import parameter_sets as set_rows
from boresight.store import uplinks as rows
from boresight.store.sessions import Session, utc_now, utc_text
from boresight.store.tables import ParameterSet, Promotion, Uplink

NEXT: dict[str, tuple[str, ...]] = {
    "NOT SENT": ("SENT",),
    "SENT": ("LOADED", "MISMATCH", "UNKNOWN"),
    "LOADED": ("VERIFIED", "MISMATCH", "UNKNOWN"),
    "VERIFIED": ("ACTIVE", "SENT", "MISMATCH", "UNKNOWN"),
    "ACTIVE": ("MISMATCH", "UNKNOWN"),
    "MISMATCH": ("SENT", "UNKNOWN"),
    "UNKNOWN": ("SENT", "LOADED", "VERIFIED", "MISMATCH"),
}


def record(
    session: Session,
    actor: Actor,
    parameter_set_id: int,
    onboard_state: str,
    source: str,
    seen_version: int | None = None,
) -> Uplink:
    """Record the next on-board state of a set, with where it is known from.

    Parameters
    ----------
    source
        Pass, procedure or read-back file that it is known from; needed.
    seen_version
        Version of the set that was looked at; None where a form shows the next steps itself.

    Raises
    ------
    ForbiddenError
        When the actor is no operator.
    StaleError
        When the set changed since.
    RefusedInputError
        When the state does not exist or the source is missing.
    ConflictError
        When the state does not follow the one recorded, or the set to be sent is not the baseline.
    """
    require_role(actor, "operator")
    require_scope(actor, "uplinks")
    require_user(actor, "record an uplink")
    refuse_control_characters(source=source)
    row = get_parameter_set(session, parameter_set_id)
    if seen_version is not None:
        require_seen(session, row, seen_version)
    _refuse_step(row, onboard_state, source)
    if onboard_state == "ACTIVE" and (active := set_rows.active_set(session, row.sensor_id)) is not None:
        _write(session, actor, active, "UNKNOWN", f"{row.name} was read back as active: {source.strip()}")
    return _write(session, actor, row, onboard_state, source.strip())


def _refuse_step(row: ParameterSet, onboard_state: str, source: str) -> None:
    """Refuse a step off the ladder."""
    if onboard_state not in NEXT:
        raise RefusedInputError(f"There is no on-board state {onboard_state!r}; the states are {', '.join(NEXT)}.")
    if not source.strip():
        raise RefusedInputError("Say where this is known from: the pass, the procedure or the read-back file.")
    if onboard_state not in NEXT[row.onboard_state]:
        steps = ", ".join(NEXT[row.onboard_state])
        raise ConflictError(f"{row.name} is {row.onboard_state} on board; next can be {steps}, not {onboard_state}.")
    if onboard_state == "SENT" and row.ground_state != "BASELINE":
        raise ConflictError(
            f"{row.name} is {row.ground_state}; only the baseline is sent. Have it approved and promote it."
        )


def _write(session: Session, actor: Actor, row: ParameterSet, onboard_state: str, source: str) -> Uplink:
    """Add the record and show its state on the set."""
    uplink = Uplink(
        parameter_set_id=row.id,
        onboard_state=onboard_state,
        source=source,
        recorded_utc=utc_now(),
        recorded_by=require_user(actor, "record an uplink"),
    )
    before = {"onboard_state": row.onboard_state, "version": row.version}
    row.onboard_state = onboard_state
    row.version += 1
    session.add(uplink)
    session.flush()
    after = {"onboard_state": onboard_state, "version": row.version}
    audit.append(session, actor, f"recorded {onboard_state} for", subject_of(row), before, after, source)
    return uplink


def list_uplinks(
    session: Session,
    *,
    parameter_set_id: int | None = None,
    sensor_id: int | None = None,
    before_id: int | None = None,
    limit: int = 100,
) -> Sequence[Uplink]:
    """Return a page of records, newest first; the next page starts before the last one's id."""
    return rows.uplinks(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=before_id, limit=limit
    )


def baseline_at(session: Session, sensor_id: int, time: str) -> ParameterSet | None:
    """Return what was the sensor's baseline at a time; None before there was one.

    Parameters
    ----------
    time
        ISO 8601, UTC when it names no zone.

    Raises
    ------
    RefusedInputError
        When the time cannot be read.
    """
    return set_rows.baseline_at(session, sensor_id, _time(time))


def onboard_at(session: Session, sensor_id: int, time: str) -> Sequence[tuple[ParameterSet, Uplink]]:
    """Return each set that was on its way or on board at a time, with the record that says so.

    Raises
    ------
    RefusedInputError
        When the time cannot be read.
    """
    return rows.records_until(session, sensor_id, _time(time))


def promotions_of(session: Session, sensor_id: int) -> Sequence[Promotion]:
    """Return every promotion of a sensor, newest first."""
    return set_rows.promotions(session, sensor_id)


def _time(time: str) -> str:
    """Read a time as the store writes it."""
    try:
        return utc_text(datetime.fromisoformat(time))
    except ValueError as error:
        raise RefusedInputError(f"{time!r} is no time; write it like 2026-11-21T03:04:05Z.") from error
