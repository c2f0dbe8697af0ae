"""Launching a campaign: a setting, the sensors with their sets, and what it would be before it is queued."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData, QueryParams

from boresight.api.dependencies import Reading, Who, csrf
from boresight.errors import BoresightError, NotFoundError
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.launch import origin_of
from boresight.pages.launch_data import Origin
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


def _chosen(form: FormData | QueryParams) -> list[Member]:
    """Read the sensors that are ticked, and their sets."""
    return [_member(form, int(number)) for number in map(str, form.getlist("sensors")) if number.isdecimal()]


def _member(form: FormData | QueryParams, number: int) -> Member:
    """Read the sets of a sensor, ticked or not."""
    return Member(number, _set(form, f"calibration-{number}") or "newest", _set(form, f"validation-{number}"))


def _set(form: FormData | QueryParams, name: str) -> Any:
    """Read a set's number, `newest`, or None for none."""
    value = form.get(name, "newest")
    return int(value) if isinstance(value, str) and value.isdecimal() else (value or None)


@router.get("/campaigns/new", response_class=HTMLResponse)
def campaign_form(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the form as the address says, else with the whole fleet chosen."""
    origin, address = origin_of(request, session), request.query_params
    typed = _begun(origin).amended(address)
    members = (
        _chosen(address) if "sensors" in address else [_member(address, number) for number in _able(_sets(session))]
    )
    return _page(
        request, session, actor, replace(typed, method=origin.method or typed.method), origin, members, address
    )


def _begun(origin: Origin) -> Typed:
    """Fill the settings anew, from the preset where there is one."""
    return Typed() if origin.preset is None else Typed().under(origin.preset.settings)


def _able(sets: Mapping[int, Sets]) -> list[int]:
    """Return the sensors that have something to be calibrated on."""
    return [number for number, of_sensor in sets.items() if of_sensor.calibration]


def _beginning(origin: Origin, sets: Mapping[int, Sets]) -> str:
    """Write the form as it begins, as an address's query."""
    newest = [
        (f"{purpose}-{number}", "newest")
        for number, of_sensor in sets.items()
        for purpose in ("calibration", "validation")
        if getattr(of_sensor, purpose)
    ]
    return f"{_begun(origin).query}&{urlencode([*(('sensors', number) for number in _able(sets)), *newest])}"


@router.post("/campaigns/new", response_class=HTMLResponse)
async def campaign_launch(request: Request, session: Reading, actor: Who) -> Response:
    """Apply a preset (`intent=preset`), queue the campaign (`queue`), or only check."""
    form = await request.form()
    origin = await run_in_threadpool(origin_of, request, session)
    typed, members = typed_form(form), _chosen(form)
    if form.get("intent") == "preset" and origin.preset is not None:
        typed = typed.under(origin.preset.settings)
    order = partial(_launch, actor=actor, typed=typed, origin=origin, members=members)
    if form.get("intent") == "queue":
        outcome = await attempt(request, order)
        if outcome.value is not None:
            return redirect(f"/campaigns/{outcome.value.id}", flash="The campaign is queued.")
    else:
        outcome = await run_in_threadpool(_checked, partial(order, session, validate_only=True))
    return await run_in_threadpool(_page, request, session, actor, typed, origin, members, form, outcome)


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
    given: FormData | QueryParams,
    outcome: Outcome[Any] | None = None,
) -> HTMLResponse:
    """Render the form with what was typed and what the check said."""
    fleet: Sequence[Sensor] = sensors.list_sensors(session)
    refusal, sets = outcome.refusal if outcome else None, _sets(session)
    return render(
        request,
        "campaign_launch.html",
        status_code=422 if refusal and given.get("intent") == "queue" else 200,
        sensors=fleet,
        sets=sets,
        chosen={sensor.id: _member(given, sensor.id) for sensor in fleet},
        ticked={member.sensor_id for member in members},
        nothing=Sets(),
        methods=METHODS,
        words={**WORDS, **NUMBERS},
        typed=typed,
        origin=origin,
        begun=_beginning(origin, sets),
        offers=presets.offers(session),
        refusal=refusal,
        summary=outcome.value if outcome else None,
        may_launch="analyst" in actor.roles,
    )
