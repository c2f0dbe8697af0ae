"""The gates of a set: the report that holds, assessing it anew, waiving what blocks it.

Assessing sees frames under two sets, which takes seconds: it is done before the writing transaction, as over REST.

The panel of gates that the pages of a set, of a request and of the gates themselves share.

`make_gates_panel` fills it, the macro `gates_panel` of `approvals/gates_panel.html` prints it. Its forms post to `gate_report`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console import transitions
from boresight.console.access import users
from boresight.console.access.dependencies import Who, csrf
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals import gate_profiles, gates
from boresight.console.approvals.gates import read_gate_inputs
from boresight.console.approvals.tables import GateReport, Waiver
from boresight.console.fleet import service as sensors
from boresight.console.pages.rendering import (
    ShownRefusal,
    attempt,
    proof_of_own,
    read_texts,
    redirect,
    render,
    seen_version,
)
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role
from boresight.platform.db.sessions import Session, open_reading, utc_after, utc_now
from boresight.platform.web.paging import parse_row_id
from boresight.verdicts.gates.judgement import GateRow, gate_rows

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
    """Everything that the panel shows."""

    set: ParameterSet
    report: GateReport | None
    moved: Sequence[str]
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


def make_gates_panel(
    session: Session,
    actor: Actor,
    row: ParameterSet,
    typed: TypedWaiver | None = None,
    report_sha256: str | None = None,
) -> GatesPanel:
    """Fill the panel of a set, as an actor sees it."""
    report = gates.newest_report(session, row.id, report_sha256)
    moved = [] if report is None else gates.moved_since(session, report)
    document = None if report is None else gates.with_waivers(session, report)
    rows = [] if document is None else gate_rows(document)
    now = utc_now()
    return GatesPanel(
        set=row,
        report=report,
        moved=moved,
        words="" if document is None else document["words"],
        verdict="" if document is None else document["verdict"],
        rows=rows,
        assessed_by=_name(session, report),
        profile_number=gate_profiles.profile_in_force(session, row.sensor_id).number,
        given=[(waiver, waiver.expires_utc > now) for waiver in gates.all_waivers(session, row.id)],
        may_assess=None if actor.roles.intersection(gates.ASSESSORS) else ONLY_ASSESSORS,
        may_waive=None if actor.roles.intersection({"analyst", "approver"}) else ONLY_WAIVERS,
        waivable=[one for one in rows if one.blocking and one.waivable and not moved],
        typed=typed or TypedWaiver(),
    )


def _name(session: Session, report: GateReport | None) -> str:
    """Return who assessed the set."""
    if report is None or report.created_by is None:
        return "Boresight"
    return users.get_user(session, report.created_by).printed_name


router = APIRouter(dependencies=[Depends(csrf)])


@router.get("/parameter-sets/{set_id:int}/gates", response_class=HTMLResponse)
def gate_report_page(request: Request, actor: Who, set_id: int) -> HTMLResponse:
    """Show the gates of a set."""
    return _page(request, actor, set_id)


def _page(
    request: Request, actor: Actor, set_id: int, refusal: ShownRefusal | None = None, typed: TypedWaiver | None = None
) -> HTMLResponse:
    """Render the gates of a set, with a refusal and what was typed."""
    with open_reading(request.app.state.engine) as session:
        row = transitions.get_parameter_set(session, set_id)
        return render(
            request,
            "approvals/gate_report.html",
            refused=refusal,
            set=row,
            sensor=sensors.get_sensor(session, row.sensor_id),
            panel=make_gates_panel(session, actor, row, typed),
            refusal=refusal,
        )


@router.post("/parameter-sets/{set_id:int}/assess", response_class=HTMLResponse)
async def assess(request: Request, actor: Who, set_id: int) -> Response:
    """Hold a set against its gates and show what was found."""
    try:
        examined = await run_in_threadpool(_examine, request, actor, set_id)
    except NotFoundError:
        raise
    except BoresightError as error:
        return await run_in_threadpool(_page, request, actor, set_id, ShownRefusal.of(error))

    def change(session: Session) -> GateReport:
        return gates.record_report(session, actor, examined)

    outcome = await attempt(request, change)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal)
    return redirect(f"/parameter-sets/{set_id}/gates", flash=f"Assessed: {outcome.value.verdict}.")


def _examine(request: Request, actor: Actor, set_id: int) -> gates.GateAssessment:
    """Measure and judge a set outside any transaction."""
    require_role(actor, *gates.ASSESSORS)
    state = request.app.state
    with open_reading(state.engine) as session:
        case = read_gate_inputs(session, set_id)
    return gates.examine(case, state.blobs, state.catalogue(), state.settings.catalogue_folder)


@router.post("/parameter-sets/{set_id:int}/waive", response_class=HTMLResponse)
async def waive(request: Request, actor: Who, set_id: int) -> Response:
    """Let a set pass in spite of a gate."""
    given = await read_texts(request)
    typed = TypedWaiver(**{name: given.get(name, "") for name in ("gate", "code", "reason", "days")})
    prove = proof_of_own(request, actor, given.get("password", ""))
    outcome = await attempt(request, partial(_waived, actor, set_id, typed, given), prove)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal, typed)
    return redirect(
        f"/parameter-sets/{set_id}/gates", flash=f"The gate {outcome.value.gate} is waived.", level="caution"
    )


def _waived(
    actor: Actor, set_id: int, typed: TypedWaiver, given: dict[str, str], session: Session, proof: PasswordProof
) -> Waiver:
    """Waive as the form says."""
    days = parse_row_id(typed.days)
    if days is None or days > gates.LONGEST_DAYS:
        raise RefusedInputError(
            f"{typed.days.strip()[:20]!r} is not a number of days up to {gates.LONGEST_DAYS}; type one, such as 7."
        )
    expires_utc = utc_after(days * gates.DAY_S - 1.0)  # a waiver of the longest time is within it
    version = seen_version(given)
    return gates.waive(session, actor, set_id, typed.gate, typed.code, typed.reason, expires_utc, proof, version)
