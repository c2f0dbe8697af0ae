"""What a request binds: the evidence that an approver is shown, by its hashes, and what of it stops a set.

A request binds the hashes of the set, of its run's result, of the gate report with its profile, of the table on board
and of the baseline that would be replaced, and which waivers were in force. `moved` compares them with the rows as they
are now. A request of before there were gates binds no report and no profile: it is held to what it binds.

A report says which gates block. A waiver in force lifts one that may be waived; a critical gate is lifted by nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from boresight.errors import ConflictError
from boresight.store import gates as gate_rows
from boresight.store import parameter_sets as set_rows
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, utc_now
from boresight.store.table_definitions import definition_in_force
from boresight.store.tables import Approval, ParameterSet, Run

WORDS = {
    "set_sha256": "set",
    "run_result_sha256": "run result",
    "gate_report_sha256": "gate report",
    "profile_sha256": "gate profile",
    "table_definition_sha256": "table definition",
    "incumbent_sha256": "incumbent",
    "waivers": "waivers",
}
OF_GATES = ("gate_report_sha256", "profile_sha256")  # absent from requests of before there were gates


def bound_evidence(session: Session, parameter_set: ParameterSet) -> dict[str, Any]:
    """Return the hashes of what an approver of this set is shown now, and the waivers in force."""
    run = None if parameter_set.run_id is None else session.get(Run, parameter_set.run_id)
    report = gate_rows.newest_report(session, parameter_set.id)
    profile = gate_rows.newest_profile(session, parameter_set.sensor_id)
    definition = definition_in_force(session, parameter_set.sensor_id)
    incumbent = set_rows.baseline(session, parameter_set.sensor_id)
    return {
        "set_sha256": sha256_of(parameter_set.document),
        "run_result_sha256": None if run is None else run.result_sha256,
        "gate_report_sha256": None if report is None else report.sha256,
        "profile_sha256": None if profile is None else profile.sha256,
        "table_definition_sha256": None if definition is None else definition.sha256,
        "incumbent_sha256": None if incumbent is None else incumbent.sha256,
        "waivers": [waiver.id for waiver in gate_rows.waivers_in_force(session, parameter_set.id, utc_now())],
    }


def moved(session: Session, approval: Approval, parameter_set: ParameterSet) -> list[str]:
    """Name what is not any more as the request binds it."""
    bound, current = approval.bound, bound_evidence(session, parameter_set)
    held = [name for name in bound if name in current and not (name in OF_GATES and bound[name] is None)]
    return [WORDS[name] for name in WORDS if name in held and bound[name] != current[name]]


def shown_sha256(approval: Approval) -> str:
    """Return the hash of what a signature stands for: the request with everything that it binds."""
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
    return sha256_of(shown)


def blocking_gates(session: Session, parameter_set: ParameterSet) -> list[Mapping[str, Any]]:
    """Return the gates of a set's newest report that stop it and that no waiver in force lifts."""
    report = gate_rows.newest_report(session, parameter_set.id)
    if report is None:
        return []
    blocking = set(report.document.get("blocking", ()))
    waived = {waiver.gate for waiver in gate_rows.waivers_in_force(session, parameter_set.id, utc_now())}
    gates = [gate for gate in report.document.get("gates", ()) if gate["name"] in blocking]
    return [gate for gate in gates if gate["critical"] or not gate["waivable"] or gate["name"] not in waived]


def refuse_blocked(session: Session, parameter_set: ParameterSet) -> None:
    """Refuse to let a set pass that its gates stop.

    Raises
    ------
    ConflictError
        Names the gates, and says whether they can be waived.
    """
    gates = blocking_gates(session, parameter_set)
    if not gates:
        return
    named = ", ".join(f"{gate['name']} ({gate['status']})" for gate in gates)
    fixed = [gate["name"] for gate in gates if gate["critical"] or not gate["waivable"]]
    way_out = (
        f"{', '.join(fixed)} cannot be waived: recalibrate." if fixed else "Waive it with a reason, or recalibrate."
    )
    raise ConflictError(f"{parameter_set.name} is stopped by its gates: {named}. {way_out}")
