"""Campaigns: the list, one as it goes, its results over sensors, and what people do to it."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.api.numbers import row_number
from boresight.pages.attempts import attempt
from boresight.pages.forms import read_texts
from boresight.pages.rendering import redirect, redirect_refused, render
from boresight.pages.runs import read_names
from boresight.pages.tables import csv_file
from boresight.services import campaigns
from boresight.services.campaign_views import FAILED, CampaignView, result_of
from boresight.store.sessions import Session
from boresight.verdicts.verdict import LEVELS

router = APIRouter(dependencies=[Depends(csrf)])

CAMPAIGNS_A_PAGE = 50
CSV_FIELDS = (
    "campaign", "label", "sensors", "ended", "failed", "preset", "launched_by", "launched_utc", "cancelled_utc",
)  # fmt: skip


@router.get("/campaigns", response_class=HTMLResponse)
def campaigns_page(request: Request, session: Reading, actor: Who, before: str = "") -> HTMLResponse:  # noqa: ARG001 - whoever is known may read
    """List campaigns with how far each is, newest first."""
    before_id = row_number(before)
    found = campaigns.list_campaigns(session, before_id=before_id, limit=CAMPAIGNS_A_PAGE + 1)
    shown = found[:CAMPAIGNS_A_PAGE]
    return render(
        request,
        "campaigns/campaigns.html",
        campaigns=shown,
        people=read_names(session).people,
        next_before=shown[-1].id if len(found) > CAMPAIGNS_A_PAGE else None,
    )


@router.get("/campaigns.csv")
def campaigns_csv(session: Reading, actor: Who) -> Response:  # noqa: ARG001 - whoever is known may read
    """Give every campaign as CSV, newest first."""
    people, found = read_names(session).people, campaigns.list_campaigns(session)
    return csv_file("campaigns", CSV_FIELDS, (_csv_row(view, people) for view in found))


def _csv_row(view: CampaignView, people: Mapping[int, str]) -> dict[str, Any]:
    """Lay out a campaign for a program."""
    row = view.row
    return {
        "campaign": view.id,
        "label": row.label,
        "sensors": view.sensors,
        "ended": view.ended,
        "failed": view.failed,
        "preset": row.preset,
        "launched_by": people.get(row.launched_by, "system") if row.launched_by is not None else "system",
        "launched_utc": row.launched_utc,
        "cancelled_utc": row.cancelled_utc,
    }


@router.get("/campaigns/{campaign_id:int}", response_class=HTMLResponse)
def campaign_page(request: Request, session: Reading, actor: Who, campaign_id: int) -> HTMLResponse:
    """Show a campaign: its bar, what failed and why, and what its sensors came to."""
    view = campaigns.read_campaign(session, campaign_id)
    lines = _lines(session, campaign_id)
    return render(
        request,
        "campaigns/campaign.html",
        view=view,
        failed=[line for line in lines if line["state"] in FAILED],
        lines=lines,
        people=read_names(session).people,
        may_launch="analyst" in actor.roles,
    )


def _lines(session: Session, campaign_id: int) -> list[dict[str, Any]]:
    """Return what the sensors came to, the worst first: what failed, then by verdict."""
    lines = [result_of(one) for one in campaigns.results(session, campaign_id)]
    return sorted(lines, key=_rank)


def _rank(line: Mapping[str, Any]) -> tuple[int, int, str]:
    """Order what needs a look first, then by name."""
    level = LEVELS.index(line["level"]) if line["level"] in LEVELS else -1
    return (0 if line["state"] in FAILED else 1, -level, line["sensor"])


@router.get("/campaigns/{campaign_id:int}/results.csv")
def campaign_results(session: Reading, actor: Who, campaign_id: int) -> Response:  # noqa: ARG001 - whoever is known may read
    """Send the results over sensors as CSV, arcs in rad."""
    headers = {"Content-Disposition": f'attachment; filename="campaign-{campaign_id}.csv"'}
    return Response(_csv(_lines(session, campaign_id)), media_type="text/csv", headers=headers)


def _csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """Write lines as CSV; what a run has not is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [name for name in lines[0] if name != "id"], extrasaction="ignore")
    writer.writeheader()
    writer.writerows([{name: _cell(value) for name, value in line.items()} for line in lines])
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Keep a spreadsheet from taking a text that people gave for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in {"=", "+", "-", "@", "\t", "\r"} else value


@router.post("/campaigns/{campaign_id:int}/cancel", response_class=HTMLResponse)
async def cancel(request: Request, actor: Who, campaign_id: int) -> Response:
    """Stop all of it."""
    reason = (await read_texts(request)).get("reason", "")
    change = partial(campaigns.cancel_campaign, actor=actor, campaign_id=campaign_id, reason=reason)
    return await _done(request, campaign_id, change, "Every run that had not ended was asked to stop.")


@router.post("/campaigns/{campaign_id:int}/launch-failed", response_class=HTMLResponse)
async def launch_failed(request: Request, actor: Who, campaign_id: int) -> Response:
    """Launch again what failed."""
    change = partial(campaigns.relaunch_failed, actor=actor, campaign_id=campaign_id)
    return await _done(request, campaign_id, change, "What failed is queued again.")


async def _done(request: Request, campaign_id: int, change: Callable[..., Any], words: str) -> Response:
    """Make a change and go back to the campaign with what came of it."""
    outcome = await attempt(request, change)
    if outcome.refusal is not None:
        return redirect_refused(f"/campaigns/{campaign_id}", outcome.refusal)
    return redirect(f"/campaigns/{campaign_id}", flash=words)
