"""What is done with several runs of the list at once, each by itself: its own transaction, its own refusal, its own result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from fastapi import Depends, Form, Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import Who, csrf, get_server
from boresight.console.approvals.pages.gates import assess_set
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, read_again, render
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.runs import service as runs
from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id

router = PageRouter(dependencies=[Depends(csrf)])

ACTS = {"assess": "Assess", "archive": "Archive", "restore": "Restore"}
MOST = {"assess": 20, "archive": 200, "restore": 200}  # a measurement on validation frames takes up to seconds


@dataclass(frozen=True)
class RunOutcome:
    """What came of one run: a word with its level, a sentence, and where to go on."""

    run_id: int
    word: str
    sentence: str
    address: str


@router.post("/runs/batch", response_class=HTMLResponse)
async def batch(
    request: Request, actor: Who, runs: Annotated[str, Form()] = "", act: Annotated[str, Form()] = ""
) -> Response:
    """Assess, archive or restore the chosen runs, and tell what came of each."""
    chosen = [text.strip() for text in runs.split(",") if text.strip()]
    numbers = list(dict.fromkeys(number for text in chosen if (number := parse_row_id(text))))
    if unread := [text for text in chosen if not parse_row_id(text)]:
        raise RefusedInputError(f"{unread[0][:20]!r} is not the number of a run; choose runs in the list.")
    if act not in ACTS:
        raise RefusedInputError(f"{act[:20]!r} is not an action for runs; choose from {', '.join(ACTS)}.")
    if not 0 < len(numbers) <= MOST[act]:
        raise RefusedInputError(f"{len(numbers)} runs are chosen; choose 1 to {MOST[act]} in the list.")
    outcomes = [await _take(request, actor, act, number) for number in numbers]
    return await read_again(request, partial(_page, request, act, outcomes))


def _page(request: Request, act: str, outcomes: Sequence[RunOutcome], _session: Session) -> HTMLResponse:
    return render(request, "runs/batch.html", title=ACTS[act], outcomes=outcomes)


async def _take(request: Request, actor: Actor, act: str, run_id: int) -> RunOutcome:
    try:
        return await (_assess(request, actor, run_id) if act == "assess" else _hide(request, actor, act, run_id))
    except NotFoundError as error:
        return _refused(run_id, RefusalContext.of(error))


async def _hide(request: Request, actor: Actor, act: str, run_id: int) -> RunOutcome:
    change = runs.archive_run if act == "archive" else runs.restore_run
    outcome = await attempt(request, partial(change, actor=actor, run_id=run_id))
    if outcome.refusal is not None:
        return _refused(run_id, outcome.refusal)
    said = "Archived: hidden from lists." if act == "archive" else "Restored: shown in lists."
    return RunOutcome(run_id, "DONE", said, f"/runs/{run_id}")


async def _assess(request: Request, actor: Actor, run_id: int) -> RunOutcome:
    """Hold the set of a run against the gates; one is made where the run has none."""
    make = partial(parameter_sets.create_from_run, actor=actor, blobs=get_server(request).blobs, run_id=run_id)
    made = await attempt(request, make)
    if made.refusal is not None:
        return _refused(run_id, made.refusal)
    number, name = made.made.id, made.made.name
    assessed = await assess_set(request, actor, number)
    if assessed.refusal is not None:
        return _refused(run_id, assessed.refusal)
    return RunOutcome(
        run_id, assessed.made.verdict, f"Verdict of the gates of {name}.", f"/parameter-sets/{number}/gates"
    )


def _refused(run_id: int, refusal: RefusalContext) -> RunOutcome:
    """Tell a refusal beside the other results; a fault of the server ends the request."""
    if refusal.is_ours:
        raise refusal.error
    return RunOutcome(run_id, "REFUSED", refusal.sentence, f"/runs/{run_id}")
