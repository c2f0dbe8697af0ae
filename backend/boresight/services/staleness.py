"""When the ground under a request moves, or its time runs out: nobody may decide on it any more.

Promoting a set, a new gate profile and a new table definition make the sensor's other requests STALE at once, a waiver
those of its set. `refuse_moved` asks again at every signature and promotion, for whatever else may have happened to
the rows. A request that nobody decided on in time is EXPIRED by the server's heartbeat, or by whoever comes too late.
"""

from __future__ import annotations

from collections.abc import Sequence

from boresight.errors import ConflictError, StaleError
from boresight.services import clock
from boresight.services.actors import SYSTEM, Actor
from boresight.services.evidence import moved
from boresight.services.transitions import move, resting_state, whose_baseline
from boresight.store import approvals as approval_rows
from boresight.store.sessions import Session, keep_despite_refusal, utc_now
from boresight.store.tables import Approval, ParameterSet


def make_others_stale(session: Session, actor: Actor, promoted: ParameterSet) -> None:
    """Void the requests that compare with the baseline of before."""
    make_stale_of_sensor(session, actor, promoted.sensor_id, f"{promoted.name} became baseline")


def make_stale_of_sensor(session: Session, actor: Actor, sensor_id: int, why: str) -> None:
    """Void every request of a sensor that is not decided, or approved and not promoted yet.

    Parameters
    ----------
    why
        What moved, as the audit log and the refusals tell it: "the gate profile became version 3".
    """
    for approval in approval_rows.undecided_of_sensor(session, sensor_id):
        _make_stale(session, actor, approval, why)


def make_stale_of_set(session: Session, actor: Actor, parameter_set_id: int, why: str) -> None:
    """Void the request of one set, if it has one that is not decided, or approved and not promoted yet."""
    row = session.get_one(ParameterSet, parameter_set_id)
    for approval in approval_rows.undecided_of_sensor(session, row.sensor_id):
        if approval.parameter_set_id == parameter_set_id:
            _make_stale(session, actor, approval, why)


def _make_stale(session: Session, actor: Actor, approval: Approval, reason: str) -> None:
    """Close a request as STALE; its set may be submitted again."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    approval.closed_utc = utc_now()
    move(session, actor, approval, "STALE", "made stale", reason=reason)
    move(session, actor, row, resting_state(row, "CANDIDATE"), "returned", reason=f"its request became stale: {reason}")


def refuse_moved(session: Session, actor: Actor, approval: Approval, row: ParameterSet) -> None:
    """Make a request stale and refuse, when anything that it binds is not what it was when submitted.

    Raises
    ------
    StaleError
        Says what moved; the request stays STALE although the refusal is raised.
    """
    names = moved(session, approval, row)
    if not names:
        return
    since = whose_baseline(session, row.sensor_id)
    _make_stale(session, actor, approval, f"the {' and the '.join(names)} moved")
    keep_despite_refusal(session)
    raise StaleError(f"The {' and the '.join(names)} moved since {row.name} was submitted.{since} Submit it again.")


def is_expired(approval: Approval) -> bool:
    """Whether the time of a request is over, be it written down yet or not."""
    return approval.expires_utc is not None and approval.expires_utc <= utc_now()


def any_due(session: Session) -> bool:
    """Whether there are requests whose time is over and that still stand open."""
    return bool(approval_rows.due(session, utc_now())) and not clock.is_held(session)


def expire_due(session: Session) -> Sequence[Approval]:
    """Close every request whose time is over, and return them; their sets may be submitted again."""
    due = () if clock.is_held(session) else approval_rows.due(session, utc_now())
    for approval in due:
        _expire(session, approval)
    return due


def _expire(session: Session, approval: Approval) -> None:
    """Close a request as EXPIRED."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    approval.closed_utc = utc_now()
    reason = f"nobody decided on it before {approval.expires_utc}"
    if approval.state == "APPROVED":
        reason = f"it was approved and not promoted before {approval.expires_utc}"
    move(session, SYSTEM, approval, "EXPIRED", "let expire", reason=reason)
    move(session, SYSTEM, row, resting_state(row, "EXPIRED"), "returned", reason=f"its request expired: {reason}")


def refuse_expired(session: Session, approval: Approval, row: ParameterSet) -> None:
    """Close a request as EXPIRED and refuse, when its time is over.

    Raises
    ------
    ConflictError
        The request stays EXPIRED although the refusal is raised.
    """
    if not is_expired(approval) or clock.is_held(session):
        return
    _expire(session, approval)
    keep_despite_refusal(session)
    raise ConflictError(f"Request {approval.id} expired at {approval.expires_utc}. Submit {row.name} again.")
