"""The gates of a set: the report that holds, assessing it anew, waiving what blocks it.

Assessing sees frames under two sets, which takes seconds: it is done before the writing transaction, as over REST.
"""

from __future__ import annotations

from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Who, csrf
from boresight.api.numbers import row_number
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.pages.attempts import Refusal, attempt, proof_of_own
from boresight.pages.forms import read_texts, seen_version
from boresight.pages.gates_panel import Typed, panel_of
from boresight.pages.rendering import redirect, render
from boresight.services import gates, parameter_sets, sensors, waivers
from boresight.services.actors import Actor, require_role
from boresight.services.gate_evidence import gather
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session, reading, utc_after
from boresight.store.tables import GateReport, Waiver

router = APIRouter(dependencies=[Depends(csrf)])


@router.get("/parameter-sets/{set_id:int}/gates", response_class=HTMLResponse)
def gate_report_page(request: Request, actor: Who, set_id: int) -> HTMLResponse:
    """Show the gates of a set."""
    return _page(request, actor, set_id)


def _page(
    request: Request, actor: Actor, set_id: int, refusal: Refusal | None = None, typed: Typed | None = None
) -> HTMLResponse:
    """Render the gates of a set, with a refusal and what was typed."""
    with reading(request.app.state.engine) as session:
        row = parameter_sets.get_parameter_set(session, set_id)
        return render(
            request,
            "approvals/gate_report.html",
            refused=refusal,
            set=row,
            sensor=sensors.get_sensor(session, row.sensor_id),
            panel=panel_of(session, actor, row, typed),
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
        return await run_in_threadpool(_page, request, actor, set_id, Refusal.of(error))

    def change(session: Session) -> GateReport:
        return gates.record_report(session, actor, examined)

    outcome = await attempt(request, change)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal)
    return redirect(f"/parameter-sets/{set_id}/gates", flash=f"Assessed: {outcome.value.verdict}.")


def _examine(request: Request, actor: Actor, set_id: int) -> gates.Assessment:
    """Measure and judge a set outside any transaction."""
    require_role(actor, *gates.ASSESSORS)
    state = request.app.state
    with reading(state.engine) as session:
        case = gather(session, set_id)
    return gates.examine(case, state.blobs, state.catalogue(), state.settings.catalogue_folder)


@router.post("/parameter-sets/{set_id:int}/waive", response_class=HTMLResponse)
async def waive(request: Request, actor: Who, set_id: int) -> Response:
    """Let a set pass in spite of a gate."""
    given = await read_texts(request)
    typed = Typed(**{name: given.get(name, "") for name in ("gate", "code", "reason", "days")})
    prove = proof_of_own(request, actor, given.get("password", ""))
    outcome = await attempt(request, partial(_waived, actor, set_id, typed, given), prove)
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, set_id, outcome.refusal, typed)
    return redirect(
        f"/parameter-sets/{set_id}/gates", flash=f"The gate {outcome.value.gate} is waived.", level="caution"
    )


def _waived(
    actor: Actor, set_id: int, typed: Typed, given: dict[str, str], session: Session, proof: PasswordProof
) -> Waiver:
    """Waive as the form says."""
    days = row_number(typed.days)
    if days is None or days > waivers.LONGEST_DAYS:
        raise RefusedInputError(
            f"{typed.days.strip()[:20]!r} is not a number of days up to {waivers.LONGEST_DAYS}; type one, such as 7."
        )
    expires_utc = utc_after(days * waivers.DAY_S - 1.0)  # a waiver of the longest time is within it
    version = seen_version(given)
    return waivers.waive(session, actor, set_id, typed.gate, typed.code, typed.reason, expires_utc, proof, version)
