"""Changes of gate limits and table layouts that wait for a second person: the list, and one with what it changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Reading, Who, csrf, get_server
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, read_texts, redirect, render, seen_version
from boresight.console.pages.tables import Table, TableColumn, accept_one, read_page, read_view
from boresight.console.runs.pages.list import read_names
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import open_reading

router = PageRouter(dependencies=[Depends(csrf)])

PROPOSALS = Table(
    "change-proposals",
    "Proposed changes",
    (
        TableColumn("proposal", "Proposal", "-proposal", head=True),
        TableColumn("kind", "Of", "kind"),
        TableColumn("state", "State", "state", "tight"),
        TableColumn("by", "Proposed by", "by"),
        TableColumn("reason", "Reason", "", "words"),
        TableColumn("expires", "Expires", "expires", "tight"),
        TableColumn("part", "Your action"),
    ),
    {"show": accept_one(("open", "all"))},
    "-proposal",
)
PLACES = {"gate-profile": "gates", "table-definition": "table-definition"}
EFFECTS = {
    "confirm": "Confirmed: the change is in force; open requests of the sensor are STALE.",
    "refuse": "Refused: nothing changes.",
    "withdraw": "Withdrawn: nothing changes.",
}


@router.get("/change-proposals", response_class=HTMLResponse)
def change_proposals_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show what waits for a second person, or every proposal there was."""
    view = read_view(request, PROPOSALS)
    show = view.where.get("show", "open")
    found = read_page(session, view, show=None, state="OPEN" if show == "open" else None)
    return render(
        request,
        "change_proposals/change_proposals.html",
        view=view,
        proposals=found.rows,
        blocked={row.id: proposals.explain_why_not_decide(session, actor, row) for row in found.rows},
        last=found.last,
        show=show,
        titles=proposals.TITLES,
        names=read_names(session, sensors_of=found.rows),
    )


@router.get("/change-proposals/{proposal_id:int}", response_class=HTMLResponse)
def change_proposal_page(request: Request, actor: Who, proposal_id: int) -> HTMLResponse:
    """Show a proposal with what it changes."""
    return _page(request, actor, proposal_id, None, {})


def _page(
    request: Request, actor: Actor, proposal_id: int, refusal: RefusalContext | None, typed: Mapping[str, str]
) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        row = session.get_known(ChangeProposal, proposal_id)
        return render(
            request,
            "change_proposals/change_proposal.html",
            refused=refusal,
            proposal=row,
            title=proposals.TITLES[row.kind],
            place=PLACES[row.kind],
            sensor=session.get_known(Sensor, row.sensor_id),
            differences=proposals.list_differences(session, row),
            blocked=proposals.explain_why_not_decide(session, actor, row),
            may_withdraw=proposals.may_withdraw(session, actor, row),
            names=read_names(session),
            refusal=refusal,
            typed=typed,
        )


@router.post("/change-proposals/{proposal_id:int}/decide", response_class=HTMLResponse)
async def decide(request: Request, actor: Who, proposal_id: int) -> Response:
    """Confirm or refuse a proposal, or take it back."""
    form = await read_texts(request)
    action, comment = form.get("action", ""), form.get("comment", "")
    seen = seen_version(form)
    changes: dict[str, Callable[..., ChangeProposal]] = {
        "confirm": partial(proposals.confirm, actor=actor, proposal_id=proposal_id, seen_version=seen, comment=comment),
        "refuse": partial(proposals.refuse, actor=actor, proposal_id=proposal_id, seen_version=seen, comment=comment),
        "withdraw": partial(proposals.withdraw, actor=actor, proposal_id=proposal_id, seen_version=seen),
    }
    if action not in changes:
        return redirect(f"/change-proposals/{proposal_id}")
    outcome = await attempt(request, changes[action])
    if outcome.value is None:
        return await run_in_threadpool(_page, request, actor, proposal_id, outcome.refusal, form)
    return redirect(f"/change-proposals/{proposal_id}", flash=EFFECTS[action])
