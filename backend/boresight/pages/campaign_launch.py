"""Launching a campaign: a setting, the sensors with their sets, and what it would be before it is queued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData

from boresight.api.dependencies import Reading, Who, csrf
from boresight.errors import BoresightError, NotFoundError
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.launch import Origin, origin_of
from boresight.pages.launch_form import Typed, typed_form
from boresight.pages.methods import METHODS, NUMBERS, WORDS
from boresight.pages.rendering import redirect, render
from boresight.services import campaigns, presets, sensors, telemetry_sets
from boresight.services.actors import Actor
from boresight.services.campaign_places import Member
from boresight.store.sessions import Session
from boresight.store.tables import Sensor

router = APIRouter(dependencies=[Depends(csrf)])

MOST_SETS = 5000


@dataclass(frozen=True)
class Sets:
    """A sensor's sets in use, newest first."""

    calibration: list[Any] = field(default_factory=list)
    validation: list[Any] = field(default_factory=list)


def _sets(session: Session) -> dict[int, Sets]:
    """Return the sets of every sensor."""
    found: dict[int, Sets] = {}
    for row in telemetry_sets.list_telemetry_sets(session, limit=MOST_SETS):
        getattr(found.setdefault(row.sensor_id, Sets()), row.purpose).append(row)
    return found


def _chosen(form: FormData) -> list[Member]:
    """Read the sensors that are ticked, and their sets."""
    return [
        Member(int(number), _set(form, f"calibration-{number}") or "newest", _set(form, f"validation-{number}"))
        for number in map(str, form.getlist("sensors"))
        if number.isdecimal()
    ]


def _set(form: FormData, name: str) -> Any:
    """Read a set's number, `newest`, or None for none."""
    value = form.get(name, "newest")
    return int(value) if isinstance(value, str) and value.isdecimal() else (value or None)


@router.get("/campaigns/new", response_class=HTMLResponse)
def campaign_form(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the form with the whole fleet chosen."""
    origin = origin_of(request, session)
    typed = Typed() if origin.preset is None else Typed().under(origin.preset.settings)
    sets = _sets(session)
    fleet = sensors.list_sensors(session)
    members = [Member(sensor.id) for sensor in fleet if sensor.id in sets and sets[sensor.id].calibration]
    return _page(request, session, actor, typed, origin, members)


@router.post("/campaigns/new", response_class=HTMLResponse)
async def campaign_launch(request: Request, session: Reading, actor: Who) -> Response:
    """Apply a preset (`intent=preset`), queue the campaign (`queue`), or only check."""
    form = await request.form()
    origin = await run_in_threadpool(origin_of, request, session)
    typed, members = typed_form(form, ()), _chosen(form)
    if form.get("intent") == "preset" and origin.preset is not None:
        typed = typed.under(origin.preset.settings)
    order = partial(_launch, actor=actor, typed=typed, origin=origin, members=members)
    if form.get("intent") == "queue":
        outcome = await attempt(request, order)
        if outcome.value is not None:
            return redirect(f"/campaigns/{outcome.value.id}", flash="The campaign is queued.")
    else:
        outcome = await run_in_threadpool(_checked, partial(order, session, validate_only=True))
    return await run_in_threadpool(_page, request, session, actor, typed, origin, members, outcome)


def _launch(
    session: Session,
    actor: Actor,
    typed: Typed,
    origin: Origin,
    members: Sequence[Member],
    *,
    validate_only: bool = False,
) -> Any:
    """Hand the form to the service; a preset's own free parameters go with it."""
    preset = origin.preset
    free = preset.settings.get("free") if preset else None
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


def _checked(ask: partial[Any]) -> Outcome[Any]:
    """Make the dry run: it reads and writes nothing."""
    try:
        return Outcome(ask(), None)
    except NotFoundError:
        raise
    except BoresightError as error:
        return Outcome(None, Refusal.of(error))


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    typed: Typed,
    origin: Origin,
    members: Sequence[Member],
    outcome: Outcome[Any] | None = None,
) -> HTMLResponse:
    """Render the form with what was typed and what the check said."""
    fleet: Sequence[Sensor] = sensors.list_sensors(session)
    refusal = outcome.refusal if outcome else None
    return render(
        request,
        "campaign_launch.html",
        status_code=422 if refusal else 200,
        sensors=fleet,
        sets=_sets(session),
        chosen={member.sensor_id: member for member in members},
        nothing=Sets(),
        methods=METHODS,
        words={**WORDS, **NUMBERS},
        typed=typed,
        origin=origin,
        offers=presets.offers(session),
        refusal=refusal,
        summary=outcome.value if outcome else None,
        may_launch="analyst" in actor.roles,
    )
