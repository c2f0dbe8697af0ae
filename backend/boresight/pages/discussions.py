"""What people do around a request besides signing: open its evidence, say something, ask somebody to decide."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.api.numbers import row_number
from boresight.errors import NotFoundError
from boresight.pages.approval import Words, addresses_of, request_page
from boresight.pages.attempts import attempt
from boresight.pages.forms import read_texts, seen_version
from boresight.pages.rendering import redirect
from boresight.services import approvals, parameter_sets
from boresight.store.sessions import Session, reading
from boresight.store.tables import Approval

router = APIRouter(dependencies=[Depends(csrf)])


@router.post("/approvals/{approval_id:int}/open")
async def open_evidence(
    request: Request, actor: Who, approval_id: int, evidence: Annotated[str, Form()] = ""
) -> Response:
    """Keep that a piece of evidence was opened, and go there."""
    with reading(request.app.state.engine) as session:
        row = parameter_sets.get_parameter_set(session, approvals.get_approval(session, approval_id).parameter_set_id)
        incumbent = parameter_sets.baseline_of(session, row.sensor_id)
    known = addresses_of(row, incumbent)
    if evidence not in known:
        raise NotFoundError(f"There is no evidence {evidence!r} for this request; choose one of its list.")
    opening = partial(approvals.record_opening, actor=actor, approval_id=approval_id, evidence=evidence)
    outcome = await attempt(request, opening)
    if outcome.refusal is not None and outcome.refusal.is_ours:
        raise outcome.refusal.error  # what was not kept would not count as opened
    return redirect(known[evidence][1])


@router.post("/approvals/{approval_id:int}/remarks")
async def remark(
    request: Request, session: Reading, actor: Who, approval_id: int, text: Annotated[str, Form()] = ""
) -> Response:
    """Say something about a request."""
    outcome = await attempt(request, partial(approvals.remark, actor=actor, approval_id=approval_id, text=text))
    if outcome.value is None:
        typed = Words("remark", text=text)
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#discussion", flash="Your remark is kept.")


@router.post("/approvals/{approval_id:int}/assign")
async def assign(request: Request, session: Reading, actor: Who, approval_id: int) -> Response:
    """Ask a person to decide on a request."""
    form = await read_texts(request)

    def change(session: Session) -> Approval:
        user_id = row_number(form.get("person", ""))
        policy = request.app.state.policy
        return approvals.assign(session, actor, approval_id, user_id, seen_version(form), policy=policy)

    outcome = await attempt(request, change)
    if outcome.value is None:
        typed = Words("assign")
        page = partial(request_page, request, session, actor, approval_id, refusal=outcome.refusal, typed=typed)
        return await run_in_threadpool(page)
    return redirect(f"/approvals/{approval_id}#discussion", flash="The request shows whom it is asked of.")
