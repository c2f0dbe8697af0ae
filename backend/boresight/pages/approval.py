"""A request on one page, in the order in which it should be read.

First why the requester wants it, then what changes, the gates against the incumbent, the warnings and waivers, the
evidence and who opened it, what people said, who has signed, and only then the signature. A refused form comes back in
its place with everything typed but the password. The buttons name their effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse

from boresight.figures import FIGURES, WIDE
from boresight.figures.parameter_table import UNEXPECTED_TYPICAL_SIGMAS, ParameterRow, set_rows
from boresight.pages.attempts import Refusal
from boresight.pages.gates_panel import panel_of
from boresight.pages.parameter_sets import bound_incumbent
from boresight.pages.rendering import render
from boresight.pages.runs import read_names
from boresight.services import approvals, parameter_sets, proposals, runs, sensors
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import Approval, Opening, ParameterSet
from boresight.verdicts.verdict import marks

CHANGE_FIGURE = "radial"
EVIDENCE_FIGURES = ("rms", "arc-uncertainty", "shadow", "two-halves", "observability", "parameters")
MEANINGS = {
    "APPROVE": "I reviewed the evidence and approve this set for baseline",
    "REFUSE": "I reviewed the evidence and refuse this set",
}


@dataclass(frozen=True)
class Evidence:
    """A piece of evidence: its name in the store, what it is called, where it is, and who opened it first when."""

    name: str
    title: str
    address: str
    opened: Sequence[Opening]


def evidence_of(
    session: Session, approval: Approval, row: ParameterSet, incumbent: ParameterSet | None
) -> list[Evidence]:
    """Return what an approver can open, with who has."""
    opened = approvals.openings_of(session, approval.id)
    return [
        Evidence(name, title, address, [one for one in opened if one.evidence == name])
        for name, (title, address) in addresses_of(row, incumbent).items()
    ]


def addresses_of(row: ParameterSet, incumbent: ParameterSet | None) -> dict[str, tuple[str, str]]:
    """Return where each piece of evidence of a set is to be seen."""
    own = {
        "set": (f"{row.name}: values, identity, lineage", f"/parameter-sets/{row.id}"),
        "gate-report": ("Gates: every answer with its reason", f"/parameter-sets/{row.id}/gates"),
    }
    if row.run_id is None:
        return own
    run = {
        "run": (f"Run #{row.run_id}: convergence, RMS, observability", f"/runs/{row.run_id}"),
        "trust": ("Trust: two halves, efficiency, suspect stars", f"/runs/{row.run_id}?part=trust"),
        "matching": ("Matching: what was matched and lost", f"/runs/{row.run_id}?part=matching"),
    }
    if incumbent is not None and incumbent.run_id is not None:
        run["compare"] = (f"Beside {incumbent.name}", f"/compare?runs={incumbent.run_id},{row.run_id}")
    return run | own


@dataclass(frozen=True)
class Words:
    """What was typed into a form of the page, without its password."""

    form: str = ""
    decision: str = ""
    meaning: str = ""
    comment: str = ""
    name: str = ""
    text: str = ""


def warnings_of(result: Mapping[str, Any] | None, rows: Sequence[ParameterRow], *, is_ground: bool) -> list[str]:
    """Gather what an approver should have read before signing."""
    said = [str(sentence) for sentence in (result or {}).get("advice") or ()]
    said += [
        f"{row.name} moves by {abs(row.delta_over_typical or 0.0):.1f} typical sigmas, more than"
        f" {UNEXPECTED_TYPICAL_SIGMAS:g}: look at the matches before believing it."
        for row in rows
        if row.unexpected and row.estimated
    ]
    if result is not None and not result.get("validation"):
        said.append("No validation set: nothing outside the fitted frames says that this is better.")
    if is_ground:
        said.append("This is a ground calibration: declared, not estimated from telemetry.")
    return said


def request_page(
    request: Request,
    session: Session,
    actor: Actor,
    approval_id: int,
    *,
    refusal: Refusal | None = None,
    typed: Words | None = None,
) -> HTMLResponse:
    """Render a request, with a refused form's words in their place."""
    approval = approvals.get_approval(session, approval_id)
    row = parameter_sets.get_parameter_set(session, approval.parameter_set_id)
    sensor = sensors.get_sensor(session, row.sensor_id)
    incumbent = bound_incumbent(session, row, approval)
    result = runs.result(session, request.app.state.blobs, row.run_id) if row.run_id is not None else None
    rows = set_rows(row.document, incumbent.document if incumbent else None, sensor.document)
    policy = request.app.state.policy
    has_figures = row.run_id is not None
    return render(
        request,
        "approvals/approval.html",
        refused=refusal,
        approval=approval,
        set=row,
        sensor=sensor,
        incumbent=incumbent,
        names=read_names(session),
        rows=rows,
        change_figure=FIGURES[CHANGE_FIGURE] if has_figures else None,
        panel=panel_of(session, actor, row, report_sha256=approval.bound.get("gate_report_sha256")),
        marks=marks(result) if result else [],
        warnings=warnings_of(result, rows, is_ground=row.run_id is None),
        evidence=evidence_of(session, approval, row, incumbent),
        figures=[FIGURES[name] for name in EVIDENCE_FIGURES if has_figures],
        wide=WIDE,
        remarks=approvals.remarks_of(session, approval_id),
        signatures=approvals.signatures_of(session, approval_id),
        pending=proposals.open_proposals(session, row.sensor_id) if approval.state in {"OPEN", "APPROVED"} else [],
        signers=approvals.who_may_sign(session, approval_id, policy=policy) if approval.state == "OPEN" else [],
        blocked=approvals.why_not_sign(session, actor, approval_id, policy=policy),
        decisions=_decisions(approval, row),
        meanings=MEANINGS.values(),
        refusal=refusal,
        typed=typed or Words(),
        may_speak=bool(actor.roles - {"viewer"}),
        may_promote="operator" in actor.roles,
    )


def _decisions(approval: Approval, row: ParameterSet) -> list[tuple[str, str]]:
    """Name the effect of each decision that the request's state still has."""
    refuse = ("REFUSE", f"Refuse {row.name}")
    return [("APPROVE", f"Approve {row.name} for baseline"), refuse] if approval.state == "OPEN" else [refuse]
