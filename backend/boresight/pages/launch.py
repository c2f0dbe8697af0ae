"""Launching a run, in steps on one page: where to begin, data, method, parameters, the dry run, the queue.

The dry run is the service's own (`validate_only`), so that what it accepts is what queueing accepts. On a refusal the form
comes back with everything that was typed. The address holds where the form begins: `?sensor=`, `?set=`, `?method=`,
`?preset=`, and `?clone=` a run, whose settings the page then compares with what is chosen; what was sought of a large fleet
(`?find=`); and every field that was changed since.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData

from boresight.api.dependencies import Reading, Sighted, Who, csrf
from boresight.api.numbers import row_number
from boresight.calibration.options import METHODS, OPTIONS, CalibrationSettings
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.forms import texts_of
from boresight.pages.launch_data import (
    LONGEST_NUMBER,
    OF_A_SENSOR,
    Offered,
    Origin,
    about_its_sensor,
    first_choice,
    found_alone,
    free_of,
    names_of,
    offer,
    sensor_meant,
    sets_of_clone,
)
from boresight.pages.launch_form import Typed, typed_form, whole
from boresight.pages.launch_summary import Difference, differences, dry_run_of
from boresight.pages.rendering import redirect, render
from boresight.services import presets, runs, sensors, telemetry_sets
from boresight.services.actors import Actor
from boresight.services.forecasts import Sight
from boresight.store.sessions import Session
from boresight.store.tables import Sensor

router = APIRouter(dependencies=[Depends(csrf)])


def _launch(session: Session, actor: Actor, typed: Typed, sight: Sight | None = None) -> Any:
    """Hand the typed form to the service; with something to look at, only to ask what the run would be."""
    return runs.launch(
        session,
        actor,
        whole(typed.sensor_id, "sensor"),
        whole(typed.telemetry_set_id, "calibration set"),
        typed.settings(),
        validation_set_id=whole(typed.validation_set_id, "validation set") if typed.validation_set_id else None,
        label=typed.label.strip(),
        validate_only=sight is not None,
        sight=sight,
    )


def _saved(session: Session, actor: Actor, typed: Typed, name: str, sentence: str) -> Any:
    """Keep the typed settings under a name; the sensor's own free parameters are left to each sensor."""
    settings = typed.settings()
    sensor = sensors.get_sensor(session, whole(typed.sensor_id, "sensor"))
    own = set(settings["free"]) == set(free_of(sensor))
    return presets.save_preset(session, actor, name, sentence, {**settings, "free": None if own else settings["free"]})


def origin_of(request: Request, session: Session) -> Origin:
    """Read where the form begins from the address; what names nothing is left out, except a preset, which is refused."""
    given = request.query_params
    texts = {name: given.get(name, "") for name in ("sensor", "set", "clone")}
    numbers = {name: int(text) for name, text in texts.items() if text.isdecimal() and len(text) <= LONGEST_NUMBER}
    method = given.get("method", "")
    return Origin(
        numbers.get("sensor"),
        numbers.get("set"),
        numbers.get("clone"),
        method if method in METHODS else "",
        presets.get_offer(session, given["preset"]) if given.get("preset") else None,
        given.get("find", "").strip(),
    )


def _begun(session: Session, offered: Offered, origin: Origin) -> Typed:
    """Fill the form anew from where it begins: data first, then the preset's settings, then the method."""
    typed = first_choice(session, offered.fleet, origin.clone, offered.shown or origin.sensor, origin.set_id)
    typed = typed if origin.preset is None else typed.under(origin.preset.settings)
    return typed.with_settings({"method": origin.method}) if origin.method else typed


@router.get("/runs/new", response_class=HTMLResponse)
def launch_page(request: Request, session: Reading, actor: Who) -> Response:
    """Show the form, empty or filled from a run, a telemetry set or a preset."""
    origin, address = origin_of(request, session), request.query_params
    named = [*(address.get(name, "") for name in OF_A_SENSOR), *sets_of_clone(session, origin)]
    offered = offer(session, origin.find, sensor_meant(session, origin, address), named)
    if query := found_alone(offered, address):
        return redirect(f"/runs/new?{query}")
    return _page(request, session, actor, _begun(session, offered, origin).amended(address), origin, offered)


@router.post("/runs/new", response_class=HTMLResponse)
async def launch(request: Request, session: Reading, actor: Who, sight: Sighted) -> Response:
    """Apply a preset (`intent=preset`), keep one (`save`), queue the run (`queue`), or else only check.

    A form that holds the sets of one sensor and names another comes back with the sets of that one, whatever it was sent for.
    """
    form = await request.form()
    origin = await run_in_threadpool(origin_of, request, session)
    typed, intent = typed_form(form), form.get("intent")
    if form.get("shown", typed.sensor_id) != typed.sensor_id:
        typed, intent = await run_in_threadpool(about_its_sensor, session, typed), "check"
    if intent == "queue":
        outcome = await attempt(request, partial(_launch, actor=actor, typed=typed))
        if outcome.value is not None:
            return redirect(f"/runs/{outcome.value.id}", flash=f"Run #{outcome.value.id} is queued.")
    elif intent == "save":
        words = texts_of(form)
        name, sentence = words.get("preset_name", ""), words.get("preset_sentence", "")
        outcome = await attempt(request, partial(_saved, actor=actor, typed=typed, name=name, sentence=sentence))
        if outcome.value is not None:
            kept = replace(origin, preset=presets.offer_of(outcome.value))
            return redirect(f"/runs/new?{kept.query}", flash=f"{kept.preset.name} is kept." if kept.preset else "")
    else:
        if intent == "preset" and origin.preset is not None:
            typed = typed.under(origin.preset.settings)
        outcome = await run_in_threadpool(_checked, session, actor, typed, sight)
    return await run_in_threadpool(_answer, request, session, actor, typed, origin, outcome, form)


def _answer(
    request: Request,
    session: Session,
    actor: Actor,
    typed: Typed,
    origin: Origin,
    outcome: Outcome[Any],
    form: FormData,
) -> HTMLResponse:
    """Render the form that was sent."""
    sensor_id = row_number(typed.sensor_id)
    offered = offer(session, origin.find, sensor_id, [typed.telemetry_set_id, typed.validation_set_id])
    return _page(request, session, actor, typed, origin, offered, outcome=outcome, form=form)


def _checked(session: Session, actor: Actor, typed: Typed, sight: Sight) -> Outcome[Any]:
    """Make the dry run: it reads and writes nothing, so it holds nobody up."""
    try:
        return Outcome(_launch(session, actor, typed, sight=sight), None)
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
    offered: Offered,
    *,
    outcome: Outcome[Any] | None = None,
    form: FormData | None = None,
) -> HTMLResponse:
    """Render the form with what was typed and what the check said."""
    refusal: Refusal | None = outcome.refusal if outcome else None
    words = texts_of(form) if form is not None else request.query_params
    moved = form is not None and form.get("intent") in {"queue", "save"}
    return render(
        request,
        "runs/launch.html",
        refused=refusal if refusal and (moved or refusal.is_ours) else None,
        offered=offered,
        parameter_names={sensor.id: names_of(sensor) for sensor in offered.fleet},
        has_telemetry=bool(offered.sets or telemetry_sets.list_telemetry_sets(session, limit=1)),
        options=OPTIONS,
        methods=METHODS.values(),
        typed=typed,
        origin=origin,
        begun=_begun(session, offered, origin).query,
        offers=presets.offers(session),
        changes=_changes(session, typed, origin),
        preset_name=words.get("preset_name", ""),
        preset_sentence=words.get("preset_sentence", ""),
        refusal=refusal,
        summary=dry_run_of(outcome.value) if outcome and outcome.value is not None else None,
        may_launch="analyst" in actor.roles,
    )


def _changes(session: Session, typed: Typed, origin: Origin) -> list[Difference] | None:
    """Say what differs from the run that is cloned, or from the preset; None where the form began from neither."""
    sensor_id = row_number(typed.sensor_id)
    if (origin.clone is None and origin.preset is None) or sensor_id is None:
        return None
    try:
        now = CalibrationSettings.parse(typed.settings()).document()
    except RefusedInputError:
        return []  # the refusal stands beside
    before = dict(origin.preset.settings) if origin.preset else {}
    if origin.clone is not None:
        before = runs.get_run(session, origin.clone).settings
    sensor = sensors.get_sensor(session, sensor_id)
    return differences({**before, "free": before.get("free") or free_of(sensor)}, _in_order(now, before, sensor))


def _in_order(now: Mapping[str, Any], before: Mapping[str, Any], sensor: Sensor) -> dict[str, Any]:
    """Write the free parameters in the order of before where they are the same ones."""
    free = before.get("free") or free_of(sensor)
    return {**now, "free": free if set(now["free"]) == set(free) else now["free"]}
