"""One sensor: what it is, what its baseline says, what was baseline when, its telemetry and its runs.

The field of view follows from the baseline's focal length f and the detector, 2 atan(half a side / f), and one pixel
at the centre sees pitch / f. The sketch shows the detector with the principal point where the baseline has it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Who, csrf
from boresight.errors import RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.pages.attempts import Refusal, attempt
from boresight.pages.before_after import before_after
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import line_of, read_names
from boresight.pages.sensors import read_document
from boresight.pages.trend import LEVEL_OF_ANSWER
from boresight.services import alarms, gates, lists, notes, parameter_sets, runs, sensors, telemetry_sets, uplinks
from boresight.services.actors import Actor
from boresight.services.advice import advise
from boresight.services.trend import trend_of
from boresight.store.sessions import Session, reading, utc_now
from boresight.store.tables import ParameterSet, Sensor, Uplink

RUNS_SHOWN, SETS_SHOWN = 10, 100

router = APIRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class Optics:
    """What a detector and a focal length see.

    Parameters
    ----------
    rows_deg, columns_deg, diagonal_deg
        Full field of view along each side and corner to corner.
    pixel_urad
        What one pixel sees at the centre.
    principal_row_px, principal_col_px
        Where the boresight meets the detector.
    """

    rows_deg: float
    columns_deg: float
    diagonal_deg: float
    pixel_urad: float
    principal_row_px: float
    principal_col_px: float


def optics_of(detector: Mapping[str, Any], parameters: Mapping[str, float]) -> Optics:
    """Derive the field of view from a detector and camera parameters of either model."""
    f_px = parameters["f_m"] / detector["pixel_pitch_m"]
    rows, columns = detector["rows"], detector["columns"]

    def degrees(side_px: float) -> float:
        return 2.0 * math.degrees(math.atan(side_px / 2.0 / f_px))

    return Optics(
        rows_deg=degrees(rows),
        columns_deg=degrees(columns),
        diagonal_deg=degrees(math.hypot(rows, columns)),
        pixel_urad=1e6 / f_px,
        principal_row_px=parameters.get("m0_px", parameters.get("v0_px", (rows - 1) / 2.0)),
        principal_col_px=parameters.get("n0_px", parameters.get("u0_px", (columns - 1) / 2.0)),
    )


@dataclass(frozen=True)
class Value:
    """One parameter of the baseline."""

    name: str
    value: float
    sigma: float | None
    ground: float | None
    typical_sigma: float | None
    truth: float | None


def baseline_values(sensor: Sensor, baseline: ParameterSet | None) -> list[Value]:
    """Lay out the baseline's parameters in model order; a ground calibration has no measured sigma."""
    document = sensor.document
    values = baseline.document["parameters"] if baseline else document["initial"]
    measured = baseline is not None and baseline.run_id is not None
    sigma = (baseline.document.get("sigma") or {}) if baseline and measured else {}
    return [
        Value(
            name=name,
            value=value,
            sigma=sigma.get(name),
            ground=document["initial"].get(name),
            typical_sigma=document["typical_sigma"].get(name),
            truth=(sensor.truth or {}).get(name),
        )
        for name in CAMERA_MODELS[document["camera_model"]].parameter_names
        for value in (values[name],)
    ]


@dataclass(frozen=True)
class AsOf:
    """What was baseline and what was on board at a time, or why that cannot be said."""

    time: str
    baseline: ParameterSet | None
    onboard: Sequence[tuple[ParameterSet, Uplink]]
    refusal: str | None


def _as_of(session: Session, sensor_id: int, time: str) -> AsOf | None:
    """Answer the question of the form; None when nothing was asked."""
    if not time.strip():
        return None
    try:
        baseline = uplinks.baseline_at(session, sensor_id, time.strip())
        return AsOf(time, baseline, uplinks.onboard_at(session, sensor_id, time.strip()), None)
    except RefusedInputError as refusal:
        return AsOf(time, None, (), str(refusal))


@dataclass(frozen=True)
class Shown:
    """What the edit form left behind."""

    text: str = ""
    refusal: Refusal | None = None


def _page(request: Request, actor: Actor, sensor_id: int, at: str, shown: Shown) -> HTMLResponse:
    """Render a sensor."""
    with reading(request.app.state.engine) as session:
        sensor, baseline = sensors.get_sensor(session, sensor_id), parameter_sets.baseline_of(session, sensor_id)
        newest = runs.list_runs(session, sensor_id=sensor_id, limit=RUNS_SHOWN)
        names = read_names(session, newest)
        sets = parameter_sets.list_parameter_sets(session, sensor_id=sensor_id, limit=SETS_SHOWN)
        promotions = uplinks.promotions_of(session, sensor_id)
        promoted = parameter_sets.heads_of(session, {one.parameter_set_id for one in promotions})
        values = baseline_values(sensor, baseline)
        advice = advise(trend_of(session, sensor_id))
        return render(
            request,
            "fleet/sensor.html",
            refused=shown.refusal,
            sensor=sensor,
            tile=sensors.fleet_overview(session, [sensor_id])[0],
            names=names,
            baseline=baseline,
            verdict_of_baseline=gates.verdicts(session, [baseline.id]).get(baseline.id) if baseline else None,
            values=values,
            has_truth=bool(sensor.truth),
            measured=baseline is not None and baseline.run_id is not None,
            optics=optics_of(sensor.document["detector"], {it.name: it.value for it in values}),
            sets=sets,
            set_names={number: head.name for number, head in promoted.items()},
            advice=advice,
            answer_level=LEVEL_OF_ANSWER[advice.answer],
            open_alarms=alarms.list_alarms(session, alarms.Sought(sensor_id=sensor_id)),
            notes=notes.list_notes(session, actor, "sensors", sensor_id),
            promotions=promotions,
            telemetry=telemetry_sets.list_telemetry_sets(session, sensor_id=sensor_id, limit=SETS_SHOWN),
            sets_in_all=lists.count(session, "parameter-sets", {"sensor": sensor_id}),
            telemetry_in_all=lists.count(session, "telemetry", {"sensor": sensor_id, "in_use": True}),
            runs=[line_of(run, names) for run in newest],
            change=before_after(session, request.app.state.blobs, sensor_id),
            as_of=_as_of(session, sensor_id, at),
            now=utc_now()[:19] + "Z",
            file_text=shown.text or json.dumps(sensor.document, indent=2),
            may_edit=bool({"analyst", "administrator"} & actor.roles),
            shown=shown,
        )


@router.get("/sensors/{sensor_id}", response_class=HTMLResponse)
def sensor_page(request: Request, actor: Who, sensor_id: int, at: str = "") -> HTMLResponse:
    """Show a sensor, and what was baseline and on board at a time where asked."""
    return _page(request, actor, sensor_id, at, Shown())


@router.post("/sensors/{sensor_id}", response_class=HTMLResponse)
async def edit(
    request: Request,
    actor: Who,
    sensor_id: int,
    document: Annotated[str, Form()] = "",
    version: Annotated[int | None, Form()] = None,
) -> Response:
    """Change what new runs of the sensor start from."""
    outcome = await attempt(request, partial(_edit, actor, sensor_id, document, version))
    if outcome.value is not None:
        return redirect(f"/sensors/{sensor_id}", flash=f"{outcome.value.name} is changed; runs from now on start here.")
    return await run_in_threadpool(_page, request, actor, sensor_id, "", Shown(document, outcome.refusal))


def _edit(actor: Actor, sensor_id: int, text: str, version: int | None, session: Session) -> Sensor:
    """Hand the typed document to the service."""
    return sensors.edit_sensor(session, actor, sensor_id, read_document(text), version)
