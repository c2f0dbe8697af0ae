"""The gates of a set and the limits of a sensor: what was found, assessing again, waiving, trying and setting limits.

What was typed stays in the form, whether it was tried, refused or lost the race with another's change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Who, csrf, get_needed, get_server
from boresight.console.access.passwords import PasswordProof
from boresight.console.access.tables import User
from boresight.console.approvals import gate_profiles, gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals.gate_profiles import TriedProfile
from boresight.console.approvals.gates import read_gate_inputs
from boresight.console.approvals.tables import GateProfile, GateReport, Waiver
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    AttemptResult,
    RefusalContext,
    ask,
    attempt,
    proof_of_own,
    read_texts,
    redirect,
    render,
    seen_version,
)
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_queries
from boresight.console.runs.pages.list import read_names
from boresight.console.runs.tables import Run
from boresight.console.telemetry import queries as telemetry_rows
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.telemetry.validation_age import explain_old_validation
from boresight.console.uplinks.stations import make_workflow
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor, Policy, require_role
from boresight.platform.db.sessions import Session, open_reading, utc_after, utc_now
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.gates import GATES, BoundInput, Gate, name_inputs, parse_bound_report
from boresight.verdicts.gates.judgement import STATUSES, GateRow, gate_rows
from boresight.verdicts.gates.profile import THRESHOLDS

USUAL_DAYS = 7
ONLY_WAIVERS = "Only an analyst or an approver may waive a gate; ask an administrator for the role."
ONLY_ASSESSORS = "A viewer may not assess sets; ask an administrator for a role."


@dataclass(frozen=True)
class TypedWaiver:
    """What a waiver's form held when it was refused."""

    gate: str = ""
    code: str = ""
    reason: str = ""
    days: str = str(USUAL_DAYS)


@dataclass(frozen=True)
class GatesPanel:
    """The contents of the gates panel."""

    set: ParameterSet
    report: GateReport | None
    moved: Sequence[BoundInput]
    words: str
    verdict: str
    rows: Sequence[GateRow]
    assessed_by: str
    profile_number: int
    given: Sequence[tuple[Waiver, bool]]
    may_assess: str | None
    may_waive: str | None
    waivable: Sequence[GateRow]
    codes: dict[str, str] = field(default_factory=lambda: gates.CODES)
    least_letters: int = gates.LEAST_LETTERS
    longest_days: int = gates.LONGEST_DAYS
    typed: TypedWaiver = TypedWaiver()

    @property
    def blocking(self) -> Sequence[GateRow]:
        """Gates that stop the set now."""
        return [row for row in self.rows if row.blocking]

    @property
    def against(self) -> Sequence[GateRow]:
        """Gates that do not pass, the worst first."""
        found = [row for row in self.rows if row.status != "PASS"]
        return sorted(found, key=lambda row: (not row.blocking, -STATUSES.index(row.status)))

    @property
    def passing(self) -> Sequence[GateRow]:
        """Gates that pass."""
        return [row for row in self.rows if row.status == "PASS"]

    @property
    def bound(self) -> Sequence[tuple[str, str | None]]:
        """What the report is based on, in words, with its SHA-256."""
        known = {} if self.report is None else self.report.document["bound"]
        return [(name_inputs([name]).capitalize(), sha256) for name, sha256 in known.items()]

    @property
    def moved_words(self) -> str:
        """What changed since the report, for a sentence that begins with its article."""
        return name_inputs(self.moved)

    @property
    def warnings(self) -> Sequence[str]:
        """What is against the set, the worst first: evidence that changed, then every gate that does not pass."""
        outdated = [f"The {self.moved_words} changed since the gates were assessed: assess them again."]
        return [*(outdated if self.moved else ()), *(row.warning for row in self.against)]


def make_gates_panel(
    session: Session,
    actor: Actor,
    row: ParameterSet,
    typed: TypedWaiver | None = None,
    report_sha256: str | None = None,
) -> GatesPanel:
    """Fill the panel of a set, as an actor sees it."""
    report = approval_queries.find_newest_report(session, row.id, report_sha256)
    moved = outdated = [] if report is None else gates.list_moved_since(session, report)
    if row.ground_state in {"BASELINE", "SUPERSEDED"}:
        moved = [one for one in moved if one != "incumbent_sha256"]  # it was replaced by this very set
    found = None if report is None else gates.lay_waivers(session, report)
    rows = [] if found is None else gate_rows(found.gates, found.blocking)
    if any(map(_is_of_validation, rows)) and (old := _explain_old_frames(session, row, report)):
        rows = [replace(one, sentence=f"{old} {one.sentence}") if _is_of_validation(one) else one for one in rows]
    now = utc_now()
    return GatesPanel(
        set=row,
        report=report,
        moved=moved,
        words="" if found is None else found.words,
        verdict="" if found is None else found.verdict,
        rows=rows,
        assessed_by=_name(session, report),
        profile_number=gate_profiles.get_profile_in_force(session, row.sensor_id).number,
        given=[(waiver, waiver.expires_utc > now) for waiver in approval_queries.list_waivers(session, [row.id])],
        may_assess=None if actor.roles.intersection(gates.ASSESSORS) else ONLY_ASSESSORS,
        may_waive=None if actor.roles.intersection({"analyst", "approver"}) else ONLY_WAIVERS,
        waivable=[one for one in rows if one.blocking and one.waivable and not outdated],
        typed=typed or TypedWaiver(),
    )


def _explain_old_frames(session: Session, row: ParameterSet, report: GateReport | None) -> str:
    """Say that the validation frames of a report are older than the data of the set's run; empty where they are not."""
    kept = None if report is None else parse_bound_report(report.document).held_out
    if kept is None or row.run_id is None:
        return ""
    run = session.get_known(Run, row.run_id)
    fitted = [session.get_known(TelemetrySet, run.telemetry_set_id), *run_queries.list_further_sets(session, run)]
    return explain_old_validation(fitted, telemetry_rows.find_set_of_table(session, row.sensor_id, kept.sha256))


def _is_of_validation(gate: GateRow) -> bool:
    """Whether a gate has something against a set by its validation RMS, which frames older than the data explain."""
    return gate.name.startswith("validation-rms") and gate.status in {"FAIL", "MARGINAL"}


def _name(session: Session, report: GateReport | None) -> str:
    if report is None or report.created_by is None:
        return "Boresight"
    return session.get_known(User, report.created_by).printed_name


router = PageRouter(dependencies=[Depends(csrf)])


@router.get("/parameter-sets/{set_id:int}/gates", response_class=HTMLResponse)
def gate_report_page(request: Request, actor: Who, set_id: int) -> HTMLResponse:
    """Show the gates of a set."""
    return _page(request, actor, set_id)


def _page(
    request: Request, actor: Actor, set_id: int, refusal: RefusalContext | None = None, typed: TypedWaiver | None = None
) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        row = session.get_known(ParameterSet, set_id)
        return render(
            request,
            "approvals/gate_report.html",
            refused=refusal,
            set=row,
            sensor=session.get_known(Sensor, row.sensor_id),
            workflow=make_workflow(session, actor, get_server(request).policy, row),
            panel=make_gates_panel(session, actor, row, typed),
            needed=get_needed(request, session, actor),
            refusal=refusal,
        )


@router.post("/parameter-sets/{set_id:int}/assess", response_class=HTMLResponse)
async def assess(request: Request, actor: Who, set_id: int) -> Response:
    """Assess a set's gates and show the report."""
    outcome = await assess_set(request, actor, set_id)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal)
    return redirect(f"/parameter-sets/{set_id}/gates", flash=f"Assessed: {outcome.value.verdict}.")


async def assess_set(request: Request, actor: Actor, set_id: int) -> AttemptResult[GateReport]:
    """Hold a set against its sensor's gates and keep the report."""
    examined = await run_in_threadpool(ask, partial(_examine, request, actor, set_id))
    if examined.value is None:
        return AttemptResult(None, examined.refusal)
    return await attempt(request, partial(gates.record_report, actor=actor, assessment=examined.value))


def _examine(request: Request, actor: Actor, set_id: int) -> gates.GateAssessment:
    require_role(actor, *gates.ASSESSORS)
    state = get_server(request)
    with open_reading(state.engine) as session:
        case = read_gate_inputs(session, set_id)
    return gates.examine(case, state.blobs, state.catalogue(), state.settings.catalogue_folder)


@router.post("/parameter-sets/{set_id:int}/waive", response_class=HTMLResponse)
async def waive(request: Request, actor: Who, set_id: int) -> Response:
    """Let a set pass in spite of a gate."""
    given = await read_texts(request)
    typed = TypedWaiver(**{name: given.get(name, "") for name in ("gate", "code", "reason", "days")})
    prove = proof_of_own(request, actor, given)
    outcome = await attempt(request, partial(_waived, actor, set_id, typed, given), prove)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal, typed)
    return redirect(
        f"/parameter-sets/{set_id}/gates", flash=f"The gate {outcome.value.gate} is waived.", level="caution"
    )


def _waived(
    actor: Actor, set_id: int, typed: TypedWaiver, given: dict[str, str], session: Session, proof: PasswordProof
) -> Waiver:
    days = parse_row_id(typed.days)
    if days is None or days > gates.LONGEST_DAYS:
        raise RefusedInputError(
            f"{typed.days.strip()[:20]!r} is not a number of days up to {gates.LONGEST_DAYS}; type one, such as 7."
        )
    expires_utc = utc_after(days * gates.DAY_S - 1.0)  # so that a waiver of the longest allowed time is accepted
    version = seen_version(given)
    return gates.waive(session, actor, set_id, typed.gate, typed.code, typed.reason, expires_utc, proof, version)


BOXES = ("waivable", "must_have_data", "observe_only")
GOOD_SIDE = {"below": "at most", "above": "at least", "around": "within a factor of", "met": "must be met"}


@dataclass(frozen=True)
class GateLine:
    """A gate in the form: what it asks, and what stands in its fields."""

    gate: Gate
    side: str
    limit: str
    marginal: str
    boxes: Mapping[str, bool]


@dataclass(frozen=True)
class GateProfileContext:
    """What a form left behind on the page."""

    typed: Mapping[str, Any] | None = None
    reason: str = ""
    refusal: RefusalContext | None = None
    tried: Sequence[TriedProfile] | None = None
    changes: Sequence[str] = field(default_factory=tuple)


@router.get("/sensors/{sensor_id:int}/gates", response_class=HTMLResponse)
def gate_profile_page(request: Request, actor: Who, sensor_id: int) -> HTMLResponse:
    """Show the limits of a sensor."""
    return _profile_page(request, actor, sensor_id, GateProfileContext())


def _profile_page(request: Request, actor: Actor, sensor_id: int, shown: GateProfileContext) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        versions = gate_profiles.list_profiles(session, sensor_id)
        return render(
            request,
            "approvals/gate_profile.html",
            refused=shown.refusal,
            sensor=session.get_known(Sensor, sensor_id),
            current=versions[0],
            lines=list_gate_lines(shown.typed or write_form(versions[0].document)),
            versions=[
                (row, describe_changes(row, earlier))
                for row, earlier in zip(versions, [*versions[1:], None], strict=True)
            ],
            names=read_names(session),
            pending=proposals.list_open_proposals(session, sensor_id, "gate-profile"),
            confirmed=proposals.list_confirmed_by_number(session, sensor_id, "gate-profile"),
            second_person=get_server(request).policy.second_person,
            summary=None if shown.tried is None else describe_effect(shown.tried),
            may_set=None
            if "administrator" in actor.roles
            else "Only an administrator can set limits, and can neither launch "
            "runs nor sign. You can try limits on past runs, then ask an administrator to set them.",
            shown=shown,
        )


def write_form(document: Mapping[str, Any]) -> dict[str, Any]:
    """Write a profile as the form's fields."""
    typed: dict[str, Any] = {}
    for entry in document["gates"]:
        for key in THRESHOLDS:
            typed[f"{entry['name']}.{key}"] = "" if entry[key] is None else f"{entry[key]:.15g}"
        typed |= {f"{entry['name']}.{key}": entry[key] for key in BOXES}
    return typed


def list_gate_lines(typed: Mapping[str, Any]) -> list[GateLine]:
    """Lay the form out, a line a gate."""
    return [
        GateLine(
            gate,
            GOOD_SIDE[gate.direction],
            typed.get(f"{name}.limit", ""),
            typed.get(f"{name}.marginal", ""),
            {key: bool(typed.get(f"{name}.{key}")) for key in BOXES},
        )
        for name, gate in GATES.items()
    ]


def read_profile_form(typed: Mapping[str, Any]) -> dict[str, Any]:
    """Read the form's fields as a profile."""
    entries = []
    for name, gate in GATES.items():
        entry: dict[str, Any] = {"name": name}
        if gate.direction != "met":
            entry |= {key: _number(gate, key, str(typed.get(f"{name}.{key}", ""))) for key in THRESHOLDS}
        if not gate.critical:
            entry |= {key: bool(typed.get(f"{name}.{key}")) for key in BOXES}
        entries.append(entry)
    return {"gates": entries}


def _number(gate: Gate, key: str, text: str) -> float | None:
    """Read a threshold; an empty field is none."""
    if not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RefusedInputError(
            f"{gate.title}: the {key} {text.strip()!r} is not a number; leave the field empty for no limit."
        )
    return value


def describe_changes(row: GateProfile, earlier: GateProfile | None) -> list[str]:
    """Describe what a version changed."""
    if earlier is None:
        return []
    changes = []
    for old, new in zip(earlier.document["gates"], row.document["gates"], strict=True):
        changes += [
            f"{GATES[new['name']].title}, {key.replace('_', ' ')}: {_word(old[key])} → {_word(new[key])}"
            for key in new
            if old[key] != new[key]
        ]
    return changes


def _word(value: Any) -> str:
    if value is None:
        return "none"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else f"{value:.15g}"


def describe_effect(tried: Sequence[TriedProfile]) -> str:
    """Say in a sentence what limits would have done."""
    if not tried:
        return "There is no finished run to try these limits on."
    newly = [f"#{one.run_id}" for one in tried if one.blocking and not one.blocking_now]
    freed = [f"#{one.run_id}" for one in tried if one.blocking_now and not one.blocking]
    blocked = sum(bool(one.blocking) for one in tried)
    parts = [f"These limits would have blocked {blocked} of the newest {len(tried)} runs."]
    parts += [f"Newly blocked: {', '.join(newly)}."] if newly else []
    parts += [f"No longer blocked: {', '.join(freed)}."] if freed else []
    return " ".join(parts if newly or freed else [*parts, "The same as the limits in force."])


@router.post("/sensors/{sensor_id:int}/gates", response_class=HTMLResponse)
async def change(request: Request, actor: Who, sensor_id: int) -> Response:
    """Try limits on past runs, or put them into force."""
    typed = await read_texts(request)
    if typed.get("action") == "try":
        return await run_in_threadpool(_try, request, actor, sensor_id, typed)
    policy = get_server(request).policy
    outcome = await attempt(request, partial(_set, actor, sensor_id, typed, policy))
    if outcome.value is None:
        shown = GateProfileContext(typed, typed.get("reason", ""), outcome.refusal)
        return await run_in_threadpool(_profile_page, request, actor, sensor_id, shown)
    if isinstance(outcome.value, ChangeProposal):
        flash = "Proposed: it takes effect when another administrator confirms it."
        return redirect(f"/change-proposals/{outcome.value.id}", flash=flash)
    words = f"Version {outcome.value.number} of the limits is in force; open requests are STALE."
    return redirect(f"/sensors/{sensor_id}/gates", flash=words)


def _set(
    actor: Actor, sensor_id: int, typed: Mapping[str, str], policy: Policy, session: Session
) -> GateProfile | TableDefinition | ChangeProposal:
    seen = parse_row_id(typed.get("number", ""))
    asked = ("gate-profile", sensor_id, read_profile_form(typed), typed.get("reason", ""), seen)
    return proposals.change(session, actor, *asked, policy=policy)


def _try(request: Request, actor: Actor, sensor_id: int, typed: Mapping[str, str]) -> HTMLResponse:
    server = get_server(request)
    with open_reading(server.engine) as session:
        found = ask(lambda: gate_profiles.dry_run(session, server.blobs, sensor_id, read_profile_form(typed)))
    shown = GateProfileContext(typed, typed.get("reason", ""), found.refusal, found.value)
    return _profile_page(request, actor, sensor_id, shown)
