"""Launching a run: choose sensor, sets, method and free parameters, see what would run, queue it.

The dry run is the service's own (`validate_only`), so that what it accepts is what queueing accepts. On a refusal the
form comes back with everything that was typed. `?clone=ID` starts from a run's settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who, csrf
from boresight.calibration.settings import CalibrationSettings
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.figures.numbers import count
from boresight.pages.attempts import Outcome, Refusal, attempt
from boresight.pages.formats import duration
from boresight.pages.launch_form import Typed, typed_form, typed_settings, whole
from boresight.pages.methods import METHODS, NUMBERS, WORDS, title_of
from boresight.pages.rendering import redirect, render
from boresight.services import runs, sensors, telemetry_sets
from boresight.services.actors import Actor
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


@dataclass(frozen=True)
class DryRun:
    """What would run: facts to read, and warnings to think about."""

    facts: Sequence[tuple[str, str]]
    warnings: Sequence[str]


def dry_run_of(summary: Mapping[str, Any]) -> DryRun:
    """Lay out the service's dry-run summary."""
    free = summary["free"]
    facts = [
        ("Sensor", summary["sensor"]),
        ("Calibration set", summary["telemetry_set"]),
        ("Validation set", summary["validation_set"] or "none"),
        ("Method", title_of(summary["settings"]["method"])),
        ("Matches", WORDS["match"][summary["settings"]["match"]]),
        ("Other choices", _other_choices(summary["settings"]) or "as usual"),
        ("Frames", count(summary["frames"])),
        ("Stars", count(summary["stars"])),
        ("Star pairs", f"about {count(summary['pairs'])}"),
        ("Free parameters", f"{len(free)}: {', '.join(free)}"),
        ("Expected duration", f"about {duration(summary['predicted_s'])}"),
    ]
    return DryRun(facts, summary["warnings"])


def _other_choices(settings: Mapping[str, Any]) -> str:
    """List the settings that differ from the usual, apart from those with a line of their own."""
    usual = CalibrationSettings().document()
    named = {"method", "match", "free"}
    return ", ".join(
        f"{name} {settings[name]}" for name in usual if name not in named and settings[name] != usual[name]
    )


def _launch(session: Session, actor: Actor, typed: Typed, *, validate_only: bool) -> Any:
    """Hand the typed form to the service."""
    return runs.launch(
        session,
        actor,
        whole(typed.sensor_id, "sensor"),
        whole(typed.telemetry_set_id, "calibration set"),
        typed.settings(),
        validation_set_id=whole(typed.validation_set_id, "validation set") if typed.validation_set_id else None,
        label=typed.label.strip(),
        validate_only=validate_only,
    )


@router.get("/runs/new", response_class=HTMLResponse)
def launch_page(
    request: Request,
    session: Reading,
    actor: Who,
    clone: str = "",
    sensor: str = "",
    set_id: Annotated[str, Query(alias="set")] = "",
) -> HTMLResponse:
    """Show the form, empty or filled from a run or a telemetry set."""
    fleet = sensors.list_sensors(session)
    cloned, of_sensor, with_set = (int(text) if text.isdecimal() else None for text in (clone, sensor, set_id))
    typed = first_choice(session, fleet, cloned, of_sensor, with_set)
    return _page(request, session, actor, typed, clone=cloned)


@router.post("/runs/new", response_class=HTMLResponse)
async def launch(request: Request, session: Reading, actor: Who, clone: str = "") -> Response:
    """Check the form (`intent=check`) or queue the run."""
    form = await request.form()
    fleet = await run_in_threadpool(sensors.list_sensors, session)
    typed = typed_form(form, fleet)
    check = form.get("intent") != "queue"
    outcome = await attempt(request, partial(_launch, actor=actor, typed=typed, validate_only=check))
    if outcome.value is not None and not check:
        return redirect(f"/runs/{outcome.value.id}", flash=f"Run #{outcome.value.id} is queued.")
    cloned = int(clone) if clone.isdecimal() else None
    return await run_in_threadpool(partial(_page, request, session, actor, typed, clone=cloned, outcome=outcome))


def _page(
    request: Request,
    session: Session,
    actor: Actor,
    typed: Typed,
    *,
    clone: int | None,
    outcome: Outcome[Any] | None = None,
) -> HTMLResponse:
    """Render the form with what was typed and what the check said."""
    fleet = sensors.list_sensors(session)
    refusal: Refusal | None = outcome.refusal if outcome else None
    return render(
        request,
        "launch.html",
        status_code=422 if refusal else 200,
        sensors=fleet,
        sensor_names={sensor.id: sensor.name for sensor in fleet},
        parameter_names={sensor.id: _names_of(sensor) for sensor in fleet},
        sets=telemetry_sets.list_telemetry_sets(session),
        methods=METHODS,
        words={**WORDS, **NUMBERS},
        typed=typed,
        clone=clone,
        refusal=refusal,
        summary=dry_run_of(outcome.value) if outcome and outcome.value is not None else None,
        may_launch="analyst" in actor.roles,
    )
