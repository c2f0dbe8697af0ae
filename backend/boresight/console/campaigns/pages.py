"""Campaigns: the list, one as it goes, its results over sensors, launching one.

Of a small fleet every sensor has a row, and those with telemetry are ticked; of a larger one those that are ticked or
found. Finding others sends the form (`intent=find`), so that every tick and its sets stay; `intent=all` ticks what is
found besides.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData, QueryParams

from boresight.calibration.options import FORM, METHODS
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import KNOWN, Reading, Who, csrf
from boresight.console.campaigns import service as campaigns
from boresight.console.campaigns.queries import MemberStatus
from boresight.console.campaigns.service import FAILED, MOST_SENSORS, CampaignView, MemberRequest, make_result_line
from boresight.console.fleet import service as sensors
from boresight.console.fleet.service import SensorChoices
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    AttemptResult,
    ask,
    attempt,
    make_change,
    read_texts,
    redirect,
    render,
)
from boresight.console.pages.tables import Table, TableColumn, csv_file, read_all, read_page, read_view
from boresight.console.runs import presets
from boresight.console.runs.pages.launch import LONGEST_NUMBER, LaunchOrigin, TypedForm, read_origin, typed_form
from boresight.console.runs.pages.list import read_names
from boresight.console.telemetry import queries as telemetry_rows
from boresight.console.telemetry import service as telemetry_sets
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.verdicts.verdict import LEVELS

router = PageRouter(dependencies=[Depends(csrf)])

CAMPAIGNS = Table(
    "campaigns",
    "Campaigns",
    (
        TableColumn("state", "State", "", "tight"),
        TableColumn("campaign", "Campaign", "-campaign", "named", head=True),
        TableColumn("progress", "Progress"),
        TableColumn("ended", "Ended", "", "num"),
        TableColumn("failed", "Failed", "", "num"),
        TableColumn("sensors", "Sensors", "", "num"),
        TableColumn("preset", "Preset", "preset", "words"),
        TableColumn("by", "By", "by"),
        TableColumn("launched", "Launched", "-launched"),
    ),
    {},
    "-campaign",
    kind="campaigns",
)
CSV_FIELDS = (
    "campaign", "label", "sensors", "ended", "failed", "preset", "launched_by", "launched_utc", "cancelled_utc",
)  # fmt: skip


@router.get("/campaigns", response_class=HTMLResponse, dependencies=[KNOWN])
def campaigns_page(request: Request, session: Reading) -> HTMLResponse:
    """List campaigns with how far each is, newest first."""
    view = read_view(request, CAMPAIGNS)
    found = read_page(session, view)
    return render(
        request,
        "campaigns/campaigns.html",
        view=view,
        campaigns=campaigns.make_campaign_views(session, found.rows),
        last=found.last,
        people=read_names(session).people,
    )


@router.get("/campaigns.csv", dependencies=[KNOWN])
def campaigns_csv(request: Request, session: Reading) -> Response:
    """Give every campaign as CSV, in the order of the view."""
    view, people = read_view(request, CAMPAIGNS), read_names(session).people
    found = campaigns.make_campaign_views(session, list(read_all(session, view)))
    return csv_file("campaigns", CSV_FIELDS, (_csv_row(one, people) for one in found))


def _csv_row(view: CampaignView, people: Mapping[int, str]) -> dict[str, Any]:
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
    """Show a campaign: its progress, its failures with their causes, and its results by sensor."""
    view = campaigns.read_campaign(session, campaign_id)
    standings = campaigns.list_results(session, campaign_id)
    lines = _lines(standings)
    return render(
        request,
        "campaigns/campaign.html",
        view=view,
        failed=[line for line in lines if line["state"] in FAILED],
        lines=lines,
        summaries={one.id: one.summary for one in standings},
        people=read_names(session).people,
        may_launch="analyst" in actor.roles,
    )


def _lines(standings: Iterable[MemberStatus]) -> list[dict[str, Any]]:
    """Return the result lines, failures first and then by verdict, worst first."""
    return sorted(map(make_result_line, standings), key=_rank)


def _rank(line: Mapping[str, Any]) -> tuple[int, int, str]:
    """Sort key: results that need attention first, then by name."""
    level = LEVELS.index(line["level"]) if line["level"] in LEVELS else -1
    return (0 if line["state"] in FAILED else 1, -level, line["sensor"])


@router.get("/campaigns/{campaign_id:int}/results.csv", dependencies=[KNOWN])
def campaign_results(session: Reading, campaign_id: int) -> Response:
    """Send the results over sensors as CSV, arcs in rad."""
    lines = _lines(campaigns.list_results(session, campaign_id))
    return csv_file(f"campaign-{campaign_id}", [name for name in lines[0] if name != "id"], lines)


@router.post("/campaigns/{campaign_id:int}/cancel", response_class=HTMLResponse)
async def cancel(request: Request, actor: Who, campaign_id: int) -> Response:
    """Cancel the campaign."""
    reason = (await read_texts(request)).get("reason", "")
    change = partial(campaigns.cancel_campaign, actor=actor, campaign_id=campaign_id, reason=reason)
    return await make_change(
        request, change, f"/campaigns/{campaign_id}", "Every run that had not ended is being cancelled."
    )


@router.post("/campaigns/{campaign_id:int}/launch-failed", response_class=HTMLResponse)
async def launch_failed(request: Request, actor: Who, campaign_id: int) -> Response:
    """Launch the failed sensors again."""
    change = partial(campaigns.relaunch_failed, actor=actor, campaign_id=campaign_id)
    return await make_change(request, change, f"/campaigns/{campaign_id}", "What failed is queued again.")


MOST_SETS = 5000
NEWEST_SETS = 3  # sets per purpose that a row offers in a large fleet


@dataclass(frozen=True)
class SensorSets:
    """A sensor's sets in use, newest first."""

    calibration: list[Any] = field(default_factory=list)
    validation: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class OfferedSensors:
    """The sensors that have a row, the sets that each can be calibrated on, and which are ticked."""

    choices: SensorChoices
    sets: Mapping[int, SensorSets]
    ticked: Collection[int]

    @property
    def able(self) -> list[int]:
        """The sensors that have telemetry, in the order of the rows."""
        return [number for number in self.choices.names if number in self.sets and self.sets[number].calibration]

    @property
    def begun(self) -> list[int]:
        """The sensors that are ticked as the form begins."""
        return self.able if self.choices.is_all else []


def _offer(session: Session, given: FormData | QueryParams) -> OfferedSensors:
    """Read what the form offers, from a sent form or an address: the ticked sensors and the search text."""
    members = _chosen(given)
    choices = sensors.list_choices(
        session, find=str(given.get("find", "")), keep=[member.sensor_id for member in members]
    )
    chosen = {one for member in members for one in (member.telemetry_set_id, member.validation_set_id)}
    keep = [one for one in chosen if isinstance(one, int)]
    found: dict[int, SensorSets] = {}
    every = lists.count(session, "telemetry", {"in_use": True}) <= MOST_SETS if choices.is_all else False
    for row in (
        telemetry_sets.list_telemetry_sets(session)
        if every
        else telemetry_rows.read_heads(session, choices.names, NEWEST_SETS, keep)
    ):
        getattr(found.setdefault(row.sensor_id, SensorSets()), row.purpose).append(row)
    return OfferedSensors(choices, found, {member.sensor_id for member in members})


def _chosen(form: FormData | QueryParams) -> list[MemberRequest]:
    texts = map(str, form.getlist("sensors"))
    numbers = [int(text) for text in texts if text.isdecimal() and len(text) <= LONGEST_NUMBER]
    return [
        _member(form, number) for number in numbers[: MOST_SENSORS + 1]
    ]  # one more than allowed, so that it is refused


def _member(form: FormData | QueryParams, number: int) -> MemberRequest:
    return MemberRequest(number, _set(form, f"calibration-{number}") or "newest", _set(form, f"validation-{number}"))


def _set(form: FormData | QueryParams, name: str) -> Any:
    """Read a set's number, `newest`, or None for none."""
    value = form.get(name, "newest")
    is_number = isinstance(value, str) and value.isdecimal() and len(value) <= LONGEST_NUMBER
    return int(str(value)) if is_number else (value or None)


@router.get("/campaigns/new", response_class=HTMLResponse)
def campaign_form(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the form as the address says, else with the whole of a small fleet chosen."""
    origin, address = read_origin(request, session), request.query_params
    typed, offered = _begun(origin).amended(address), _offer(session, address)
    typed = typed.with_settings({"method": origin.method or typed["method"]})
    offered = offered if "sensors" in address else replace(offered, ticked=set(offered.begun))
    return _page(request, session, actor, typed, origin, offered, address)


def _begun(origin: LaunchOrigin) -> TypedForm:
    """Fill in the settings from the preset, or the defaults."""
    return TypedForm() if origin.preset is None else TypedForm().under(origin.preset.chosen)


def _beginning(origin: LaunchOrigin, offered: OfferedSensors) -> str:
    newest = [
        (f"{purpose}-{number}", "newest")
        for number, of_sensor in offered.sets.items()
        for purpose in ("calibration", "validation")
        if getattr(of_sensor, purpose)
    ]
    return f"{_begun(origin).query}&{urlencode([*(('sensors', number) for number in offered.begun), *newest])}"


@router.post("/campaigns/new", response_class=HTMLResponse)
async def campaign_launch(request: Request, session: Reading, actor: Who) -> Response:
    """Apply a preset (`intent=preset`), find sensors (`find`), tick what is found (`all`), queue (`queue`), or only check."""
    form = await request.form()
    origin = await run_in_threadpool(read_origin, request, session)
    typed, members = typed_form(form), _chosen(form)
    if form.get("intent") == "preset" and origin.preset is not None:
        typed = typed.under(origin.preset.chosen)
    launch = partial(_launch, actor=actor, typed=typed, origin=origin, members=members)
    intent, outcome = _intent(form), None
    if intent == "queue":
        outcome = await attempt(request, launch)
        if outcome.value is not None:
            return redirect(f"/campaigns/{outcome.value.id}", flash="The campaign is queued.")
    elif intent not in {"find", "all"}:
        outcome = await run_in_threadpool(ask, partial(launch, session, validate_only=True))
    offered = await run_in_threadpool(_offer, session, form)
    if intent == "all":
        offered = replace(offered, ticked={*offered.ticked, *offered.able})
    return await run_in_threadpool(_page, request, session, actor, typed, origin, offered, form, outcome)


def _intent(form: FormData) -> str:
    """Return the intent of the form; a changed search is run before all its sensors are ticked."""
    intent = str(form.get("intent", ""))
    return "find" if intent == "all" and form.get("find", "") != form.get("found", "") else intent


def _launch(
    session: Session,
    actor: Actor,
    typed: TypedForm,
    origin: LaunchOrigin,
    members: Sequence[MemberRequest],
    *,
    validate_only: bool = False,
) -> Any:
    preset = origin.preset
    free = preset.chosen.free if preset else None
    settings = {**typed.settings_of_any(), "free": free}
    return campaigns.launch_campaign(
        session,
        actor,
        typed.label,
        settings,
        members,
        preset=preset.key if preset else None,
        validate_only=validate_only,
    )


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    typed: TypedForm,
    origin: LaunchOrigin,
    offered: OfferedSensors,
    given: FormData | QueryParams,
    outcome: AttemptResult[Any] | None = None,
) -> HTMLResponse:
    refusal = outcome.refusal if outcome else None
    return render(
        request,
        "campaigns/campaign_launch.html",
        refused=refusal if refusal and (given.get("intent") == "queue" or refusal.is_ours) else None,
        offered=offered,
        has_telemetry=bool(offered.sets or telemetry_sets.list_telemetry_sets(session, limit=1)),
        chosen={number: _member(given, number) for number in offered.choices.names},
        nothing=SensorSets(),
        options=FORM,
        methods=METHODS.values(),
        typed=typed,
        origin=origin,
        begun=_beginning(origin, offered),
        offers=presets.list_offers(session),
        refusal=refusal,
        summary=outcome.value if outcome else None,
        may_launch="analyst" in actor.roles,
        most=MOST_SENSORS,
        newest=NEWEST_SETS,
    )
