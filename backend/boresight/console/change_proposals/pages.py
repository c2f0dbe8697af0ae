"""Changes of gate limits and table layouts that wait for a second person: the list, and one with what it changes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Reading, Who, csrf, get_server
from boresight.console.approvals import proposals
from boresight.console.approvals.proposals import TITLES
from boresight.console.approvals.tables import ChangeProposal
from boresight.console.change_proposals import service as second_person
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.rendering import RefusalContext, attempt, read_texts, redirect, render, seen_version
from boresight.console.runs.pages.list import read_names
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.paging import parse_row_id

router = APIRouter(dependencies=[Depends(csrf)])

ROWS_A_PAGE = 50
PLACES = {"gate-profile": "gates", "table-definition": "table-definition"}
EFFECTS = {
    "confirm": "Confirmed: the change is in force; undecided requests of the sensor are STALE.",
    "refuse": "Refused: nothing changes.",
    "withdraw": "Withdrawn: nothing changes.",
}


@router.get("/change-proposals", response_class=HTMLResponse)
def change_proposals_page(
    request: Request, session: Reading, actor: Who, show: str = "open", before: str = ""
) -> HTMLResponse:
    """Show the open proposals, or all of them."""
    state, before_id = (None if show == "all" else "OPEN"), parse_row_id(before)
    found = proposals.list_proposals(session, state=state, before_id=before_id, limit=ROWS_A_PAGE + 1)
    return render(
        request,
        "change_proposals/change_proposals.html",
        proposals=found[:ROWS_A_PAGE],
        blocked={row.id: second_person.explain_why_not_decide(session, actor, row) for row in found},
        next_before=found[ROWS_A_PAGE - 1].id if len(found) > ROWS_A_PAGE else None,
        show="all" if state is None else "open",
        titles=TITLES,
        names=read_names(session, sensors_of=found),
    )


@router.get("/change-proposals/{proposal_id:int}", response_class=HTMLResponse)
def change_proposal_page(request: Request, actor: Who, proposal_id: int) -> HTMLResponse:
    """Show a proposal with what it changes."""
    return _page(request, actor, proposal_id, None, "")


def _page(
    request: Request, actor: Actor, proposal_id: int, refusal: RefusalContext | None, comment: str
) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        row = session.get_known(ChangeProposal, proposal_id)
        own = row.proposed_by == actor.user_id
        return render(
            request,
            "change_proposals/change_proposal.html",
            refused=refusal,
            proposal=row,
            title=TITLES[row.kind],
            place=PLACES[row.kind],
            sensor=session.get_known(Sensor, row.sensor_id),
            differences=second_person.list_differences(session, row),
            blocked=second_person.explain_why_not_decide(session, actor, row),
            may_withdraw=row.state == "OPEN" and (own or "administrator" in actor.roles),
            names=read_names(session),
            refusal=refusal,
            comment=comment,
        )


@router.post("/change-proposals/{proposal_id:int}/decide", response_class=HTMLResponse)
async def decide(request: Request, actor: Who, proposal_id: int) -> Response:
    """Confirm or refuse a proposal, or take it back."""
    form = await read_texts(request)
    action, comment = form.get("action", ""), form.get("comment", "")
    seen = seen_version(form)
    changes: dict[str, Callable[..., ChangeProposal]] = {
        "confirm": partial(
            second_person.confirm, actor=actor, proposal_id=proposal_id, seen_version=seen, comment=comment
        ),
        "refuse": partial(
            second_person.refuse, actor=actor, proposal_id=proposal_id, seen_version=seen, comment=comment
        ),
        "withdraw": partial(proposals.withdraw, actor=actor, proposal_id=proposal_id, seen_version=seen),
    }
    if action not in changes:
        return redirect(f"/change-proposals/{proposal_id}")
    outcome = await attempt(request, changes[action])
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, proposal_id, outcome.refusal, comment)
    return redirect(f"/change-proposals/{proposal_id}", flash=EFFECTS[action])
