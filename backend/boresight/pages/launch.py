"""Launching a run, in steps on one page: where to begin, data, method, parameters, the dry run, the queue.

The dry run is the service's own (`validate_only`), so that what it accepts is what queueing accepts. On a refusal the form
comes back with everything that was typed. The address holds where the form begins: `?sensor=`, `?set=`, `?method=`,
`?preset=`, and `?clone=` a run, whose settings the page then compares with what is chosen; and every field that was changed since.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import FormData

from boresight.api.dependencies import Reading, Sighted, Who, csrf
from boresight.calibration.settings import CalibrationSettings
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.forms import texts_of
from boresight.pages.launch_form import Typed, typed_form, typed_settings, whole
from boresight.pages.launch_summary import Difference, differences, dry_run_of
from boresight.pages.methods import METHODS, NUMBERS, WORDS
from boresight.pages.rendering import redirect, render
from boresight.services import presets, runs, sensors, telemetry_sets
from boresight.services.actors import Actor
from boresight.services.forecasts import Sight
from boresight.services.presets import Offer
from boresight.store.sessions import Session
from boresight.store.tables import Sensor

router = APIRouter(dependencies=[Depends(csrf)])


def first_choice(
    session: Session, fleet: Sequence[Sensor], clone: int | None, sensor_id: int | None, set_id: int | None
) -> Typed:
    """Fill the form anew: from a run to clone, with a set, or with a sensor's newest sets, by default the first one's."""
    free = {sensor.id: _free_of(sensor) for sensor in fleet}
    if clone is None and set_id is not None:
        return Typed(**_sets_with(session, set_id), free=free)
    if clone is None:
        return Typed(**_newest_sets(session, fleet[0].id if sensor_id is None and fleet else sensor_id), free=free)
    run = runs.get_run(session, clone)
    known = typed_settings(run.settings)
    free[run.sensor_id] = list(run.settings.get("free") or free.get(run.sensor_id) or [])
    return Typed(
        **{
            **known,
            "sensor_id": str(run.sensor_id),
            "telemetry_set_id": str(run.telemetry_set_id),
            "validation_set_id": str(run.validation_set_id or ""),
            "label": run.label,
        },
        free=free,
    )


def _newest_sets(session: Session, sensor_id: int | None) -> dict[str, str]:
    """Choose the newest set of either purpose for a sensor."""
    if sensor_id is None:
        return {}
    newest: dict[str, str] = {}
    for known in telemetry_sets.list_telemetry_sets(session, sensor_id=sensor_id):
        newest.setdefault(known.purpose, str(known.id))
    return {
        "sensor_id": str(sensor_id),
        "telemetry_set_id": newest.get("calibration", ""),
        "validation_set_id": newest.get("validation", ""),
    }


def _sets_with(session: Session, set_id: int) -> dict[str, str]:
    """Choose this set for its purpose, and the newest of its sensor for the other."""
    known = telemetry_sets.get_telemetry_set(session, set_id)
    place = "telemetry_set_id" if known.purpose == "calibration" else "validation_set_id"
    return {**_newest_sets(session, known.sensor_id), place: str(known.id)}


def _free_of(sensor: Sensor) -> list[str]:
    """Return the parameters that a sensor's file frees; all where it names none."""
    return list(sensor.document.get("free") or _names_of(sensor))


def _names_of(sensor: Sensor) -> tuple[str, ...]:
    return CAMERA_MODELS[sensor.document["camera_model"]].parameter_names


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
    own = set(settings["free"]) == set(_free_of(sensor))
    return presets.save_preset(session, actor, name, sentence, {**settings, "free": None if own else settings["free"]})


@dataclass(frozen=True)
class Origin:
    """Where the form began: the address's own words, as far as they name something."""

    sensor: int | None = None
    set_id: int | None = None
    clone: int | None = None
    method: str = ""
    preset: Offer | None = None

    @property
    def query(self) -> str:
        """The same as an address's query."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "method": self.method}
        key = self.preset.key if self.preset else None
        return urlencode({name: value for name, value in {**named, "preset": key}.items() if value})

    def with_preset(self, key: str) -> str:
        """The address's query with a preset, whose method takes the place of the one named."""
        named = {"sensor": self.sensor, "set": self.set_id, "clone": self.clone, "preset": key}
        return urlencode({name: value for name, value in named.items() if value})


def origin_of(request: Request, session: Session) -> Origin:
    """Read where the form begins from the address; what names nothing is left out, except a preset, which is refused."""
    given = request.query_params
    numbers = {name: int(given[name]) for name in ("sensor", "set", "clone") if given.get(name, "").isdecimal()}
    method = given.get("method", "")
    return Origin(
        numbers.get("sensor"),
        numbers.get("set"),
        numbers.get("clone"),
        method if method in {known.name for known in METHODS} else "",
        presets.get_offer(session, given["preset"]) if given.get("preset") else None,
    )


def _begun(session: Session, fleet: Sequence[Sensor], origin: Origin) -> Typed:
    """Fill the form anew from where it begins: data first, then the preset's settings, then the method."""
    typed = first_choice(session, fleet, origin.clone, origin.sensor, origin.set_id)
    typed = typed if origin.preset is None else typed.under(origin.preset.settings)
    return replace(typed, method=origin.method) if origin.method else typed


@router.get("/runs/new", response_class=HTMLResponse)
def launch_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show the form, empty or filled from a run, a telemetry set or a preset."""
    origin = origin_of(request, session)
    typed = _begun(session, sensors.list_sensors(session), origin).amended(request.query_params)
    return _page(request, session, actor, typed, origin)


@router.post("/runs/new", response_class=HTMLResponse)
async def launch(request: Request, session: Reading, actor: Who, sight: Sighted) -> Response:
    """Apply a preset (`intent=preset`), keep one (`save`), queue the run (`queue`), or else only check."""
    form = await request.form()
    fleet, origin = await run_in_threadpool(lambda: (sensors.list_sensors(session), origin_of(request, session)))
    typed, intent = typed_form(form, fleet), form.get("intent")
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
    return await run_in_threadpool(partial(_page, request, session, actor, typed, origin, outcome=outcome, form=form))


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
    *,
    outcome: Outcome[Any] | None = None,
    form: FormData | None = None,
) -> HTMLResponse:
    """Render the form with what was typed and what the check said."""
    fleet = sensors.list_sensors(session)
    refusal: Refusal | None = outcome.refusal if outcome else None
    words = texts_of(form) if form is not None else request.query_params
    moved = form is not None and form.get("intent") in {"queue", "save"}
    return render(
        request,
        "launch.html",
        status_code=422 if refusal and moved else 200,
        sensors=fleet,
        sensor_names={sensor.id: sensor.name for sensor in fleet},
        parameter_names={sensor.id: _names_of(sensor) for sensor in fleet},
        sets=telemetry_sets.list_telemetry_sets(session),
        methods=METHODS,
        words={**WORDS, **NUMBERS},
        typed=typed,
        origin=origin,
        begun=_begun(session, fleet, origin).query,
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
    if (origin.clone is None and origin.preset is None) or not typed.sensor_id.isdecimal():
        return None
    try:
        now = CalibrationSettings.parse(typed.settings()).document()
    except RefusedInputError:
        return []  # the refusal stands beside
    before = dict(origin.preset.settings) if origin.preset else {}
    if origin.clone is not None:
        before = runs.get_run(session, origin.clone).settings
    sensor = sensors.get_sensor(session, int(typed.sensor_id))
    return differences({**before, "free": before.get("free") or _free_of(sensor)}, _in_order(now, before, sensor))


def _in_order(now: Mapping[str, Any], before: Mapping[str, Any], sensor: Sensor) -> dict[str, Any]:
    """Write the free parameters in the order of before where they are the same ones."""
    free = before.get("free") or _free_of(sensor)
    return {**now, "free": free if set(now["free"]) == set(free) else now["free"]}
