"""What a request binds: it becomes STALE when that changes, and EXPIRED when its time is over; its gates may block it.

Another baseline, gate profile or table definition makes the sensor's requests STALE at once, a waiver those of its set;
every signature and promotion asks again. A request of before there were gates is held to what it binds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from boresight.console.alarms import rules as alarm_rules
from boresight.console.approvals import queries as rows
from boresight.console.approvals.tables import Approval, Binding
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.transitions import describe_baseline, move, resting_state
from boresight.console.uplinks.queries import find_definition_in_force
from boresight.errors import ConflictError, StaleError
from boresight.platform.actors import SYSTEM, Actor
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, keep_despite_refusal, utc_now
from boresight.verdicts.gates import GateAnswer, parse_report

WORDS = {
    "set_sha256": "set",
    "run_result_sha256": "run result",
    "gate_report_sha256": "gate report",
    "profile_sha256": "gate profile",
    "table_definition_sha256": "table definition",
    "incumbent_sha256": "baseline",
    "waivers": "waivers",
}
OF_GATES = ("gate_report_sha256", "profile_sha256")  # absent from requests of before there were gates


def compute_binding(session: Session, parameter_set: ParameterSet) -> Binding:
    """Return the hashes of what an approver of this set is shown now, and the waivers in force."""
    run = None if parameter_set.run_id is None else session.get(Run, parameter_set.run_id)
    report = rows.find_newest_report(session, parameter_set.id)
    profile = rows.find_newest_profile(session, parameter_set.sensor_id)
    definition = find_definition_in_force(session, parameter_set.sensor_id)
    incumbent = set_rows.find_baseline(session, parameter_set.sensor_id)
    return Binding(
        set_sha256=compute_sha256(parameter_set.document),
        run_result_sha256=None if run is None else run.result_sha256,
        gate_report_sha256=None if report is None else report.sha256,
        profile_sha256=None if profile is None else profile.sha256,
        table_definition_sha256=None if definition is None else definition.sha256,
        incumbent_sha256=None if incumbent is None else incumbent.sha256,
        waivers=[waiver.id for waiver in rows.list_waivers_in_force(session, parameter_set.id, utc_now())],
    )


def find_changed_bindings(session: Session, approval: Approval, parameter_set: ParameterSet) -> list[str]:
    """List the bindings of a request that have changed."""
    bound, current = approval.binding, compute_binding(session, parameter_set)
    return [
        word
        for name, word in WORDS.items()
        if name in bound.stated
        and not (name in OF_GATES and getattr(bound, name) is None)
        and getattr(bound, name) != getattr(current, name)
    ]


def compute_binding_sha256(approval: Approval) -> str:
    """Return the hash that a signature covers: the request with everything that it binds."""
    shown: dict[str, Any] = {
        "approval": approval.id,
        "parameter_set": approval.parameter_set_id,
        "reason": approval.reason,
        "submitted_by": approval.submitted_by,
        "submitted_utc": approval.submitted_utc,
        "bound": approval.bound,
    }
    if approval.expires_utc is not None:  # a request of before requests expired was shown without these
        shown |= {"kind": approval.kind, "needed": approval.needed, "expires_utc": approval.expires_utc}
    return compute_sha256(shown)


def find_blocking_gates(session: Session, parameter_set: ParameterSet) -> list[GateAnswer]:
    """Return the gates of a set's newest report that stop it and that no waiver in force lifts."""
    report = rows.find_newest_report(session, parameter_set.id)
    if report is None:
        return []
    found = parse_report(report.document)
    waived = {waiver.gate for waiver in rows.list_waivers_in_force(session, parameter_set.id, utc_now())}
    gates = [gate for gate in found.gates if gate.name in found.blocking]
    return [gate for gate in gates if gate.critical or not gate.waivable or gate.name not in waived]


def refuse_blocked(session: Session, parameter_set: ParameterSet) -> None:
    """Refuse a set that is blocked by its gates."""
    gates = find_blocking_gates(session, parameter_set)
    if not gates:
        return
    named = ", ".join(f"{gate.name} ({gate.status})" for gate in gates)
    fixed = [gate.name for gate in gates if gate.critical or not gate.waivable]
    way_out = (
        f"{', '.join(fixed)} cannot be waived: recalibrate." if fixed else "Waive it with a reason, or recalibrate."
    )
    raise ConflictError(f"{parameter_set.name} is blocked by its gates: {named}. {way_out}", code="blocked-by-gates")


def make_others_stale(session: Session, actor: Actor, promoted: ParameterSet) -> None:
    """Make the requests stale that were compared with the former baseline."""
    make_stale_of_sensor(session, actor, promoted.sensor_id, f"{promoted.name} became the baseline")


def make_stale_of_sensor(session: Session, actor: Actor, sensor_id: int, why: str) -> None:
    """Make every request of a sensor stale that is undecided, or approved and not promoted."""
    for approval in rows.list_undecided_of_sensor(session, sensor_id):
        _make_stale(session, actor, approval, why)


def make_stale_of_set(session: Session, actor: Actor, parameter_set_id: int, why: str) -> None:
    """Make the request of one set stale if it is undecided, or approved and not promoted."""
    row = session.get_one(ParameterSet, parameter_set_id)
    for approval in rows.list_undecided_of_sensor(session, row.sensor_id):
        if approval.parameter_set_id == parameter_set_id:
            _make_stale(session, actor, approval, why)


def _make_stale(session: Session, actor: Actor, approval: Approval, reason: str) -> None:
    """Close a request as STALE; its set may be submitted again."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    approval.closed_utc = utc_now()
    move(session, actor, approval, "STALE", AuditAction.MADE_STALE, reason=reason)
    move(session, actor, row, resting_state(row, "CANDIDATE"), "returned", reason=f"its request became stale: {reason}")


def refuse_changed_binding(session: Session, actor: Actor, approval: Approval, row: ParameterSet) -> None:
    """Make a request stale and refuse, when anything that it binds is not what it was when submitted."""
    names = find_changed_bindings(session, approval, row)
    if not names:
        return
    since = describe_baseline(session, row.sensor_id)
    _make_stale(session, actor, approval, f"the {' and the '.join(names)} changed")
    keep_despite_refusal(session)
    raise StaleError(
        f"The {' and the '.join(names)} changed since {row.name} was submitted.{since} Submit it again.",
        code="changed-since-submitted",
    )


def explain_outdated(session: Session, approval: Approval, row: ParameterSet) -> str | None:
    """Say why a request is past deciding or promoting, as the next attempt will find; None where it is not."""
    if is_expired(approval) and not alarm_rules.is_held(session):
        return f"Request {approval.id} expired at {approval.expires_utc}; the set must be submitted again."
    names = find_changed_bindings(session, approval, row)
    return f"The {' and the '.join(names)} changed since {row.name} was submitted: submit it again." if names else None


def is_expired(approval: Approval) -> bool:
    """Whether the time of a request is over, even if its state does not say so yet."""
    return approval.expires_utc is not None and approval.expires_utc <= utc_now()


def is_any_request_due(session: Session) -> bool:
    """Whether any request has expired whose state does not say so yet."""
    return bool(rows.list_due_approvals(session, utc_now())) and not alarm_rules.is_held(session)


def expire_due_requests(session: Session) -> Sequence[Approval]:
    """Close every request whose time is over, and return them; their sets may be submitted again."""
    due = () if alarm_rules.is_held(session) else rows.list_due_approvals(session, utc_now())
    for approval in due:
        _expire(session, approval)
    return due


def _expire(session: Session, approval: Approval) -> None:
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    approval.closed_utc = utc_now()
    reason = f"no decision was made before {approval.expires_utc}"
    if approval.state == "APPROVED":
        reason = f"it was approved and not promoted before {approval.expires_utc}"
    move(session, SYSTEM, approval, "EXPIRED", AuditAction.LET_EXPIRE, reason=reason)
    move(session, SYSTEM, row, resting_state(row, "EXPIRED"), "returned", reason=f"its request expired: {reason}")


def refuse_expired(session: Session, approval: Approval, row: ParameterSet) -> None:
    """Close a request as EXPIRED and refuse, when its time is over."""
    if not is_expired(approval) or alarm_rules.is_held(session):
        return
    _expire(session, approval)
    keep_despite_refusal(session)
    raise ConflictError(
        f"Request {approval.id} expired at {approval.expires_utc}. Submit {row.name} again.", code="request-expired"
    )
