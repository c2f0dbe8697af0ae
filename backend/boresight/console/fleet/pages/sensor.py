"""One sensor: its baseline and what a newer calibration would change, its trend over the mission, its timeline.

The field of view is 2 atan(half a side / f), and one pixel at the centre sees pitch / f.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

from fastapi import Depends, Form, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.calibration import Calibration, Change, Evaluation, IntervalChange, Values
from boresight.calibration.parameter_set import parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.console import list_queries as lists
from boresight.console.access.dependencies import KNOWN, Reading, Who, csrf, get_server
from boresight.console.alarms import service as alarms
from boresight.console.approvals import gates
from boresight.console.fleet import service as sensors
from boresight.console.fleet import timeline
from boresight.console.fleet.pages.sensors import compute_optics, read_document
from boresight.console.fleet.status import list_fleet_tiles
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.trend import read_trend
from boresight.console.fleet.trend_document import advise, make_trend_document
from boresight.console.notes import service as notes
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, make_change, redirect, render
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.pages.list import make_run_line, read_names
from boresight.console.runs.tables import Run
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.tables import Uplink
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.figures import trend as figure
from boresight.platform.actors import Actor
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, open_reading, utc_now
from boresight.platform.web.paging import parse_row_id
from boresight.site import SITE_FIELDS
from boresight.telemetry.declarations import DECLARATIONS
from boresight.telemetry.sensors import parse_sensor
from boresight.verdicts.numbers import MISSING, NARROW_SPACE, fixed, is_number, power, urad
from boresight.verdicts.trend import Drift


@dataclass(frozen=True)
class ScoreRow:
    """One row: what it is, its unit, and before and after as printed, each with its 95 % interval or nothing."""

    name: str
    unit: str
    before: str
    before_interval: str
    after: str
    after_interval: str


@dataclass(frozen=True)
class BeforeAfter:
    """The newest result of a sensor, judged on a set."""

    run: Run
    judged_on: str
    scores: Sequence[ScoreRow]
    tolerance_urad: str


def before_after(session: Session, blobs: BlobStore, sensor_id: int) -> BeforeAfter | None:
    """Return what the newest finished run of a sensor would change, one with a validation set first; None without a run."""
    for run in run_queries.iterate_newest_finished(session, sensor_id):
        try:
            result = runs.find_calibration(session, blobs, run.id)
        except (ConflictError, NotFoundError):  # its file is gone or no calibration; an older run may still have one
            continue
        if result is not None and (judged := judged_on(result)) is not None:
            whose, evaluation = judged
            return BeforeAfter(run, whose, scores(evaluation), urad(evaluation.flight_tolerance_rad, 3))
    return None


def judged_on(result: Calibration) -> tuple[str, Evaluation] | None:
    """Return the purpose of the set that a result is judged on, and its scores; None where there are none."""
    if result.validation is not None:
        return "validation", result.validation
    if result.evaluation is not None:
        return "calibration", result.evaluation
    if result.rms_arc_rad.final is None:
        return None
    return "calibration", Evaluation(
        frames=result.frames, availability=Change(), matched_star_ratio=None, rms_arc_rad=result.rms_arc_rad
    )


def scores(evaluation: Evaluation) -> list[ScoreRow]:
    """Print the scores that an evaluation has."""
    reach, unknown = evaluation.intervals, IntervalChange(initial=[], final=[])
    ratio = Change(initial=1.0, final=evaluation.matched_star_ratio)
    reach_of_ratio = IntervalChange(initial=[], final=reach.matched_star_ratio) if reach else unknown
    available, rms = (reach.availability, reach.rms_arc_rad) if reach else (unknown, unknown)
    rows = [
        _score("Availability", "%", evaluation.availability, available, 100.0, 1),
        _score("Matched star ratio", "", ratio, reach_of_ratio, 1.0, 2),
        _score("RMS arc error", "µrad", evaluation.rms_arc_rad, rms, 1e6, 1),
    ]
    return [row for row in rows if row.after != MISSING]


def _score(name: str, unit: str, values: Change, reach: IntervalChange, factor: float, decimals: int) -> ScoreRow:
    printed = [
        text
        for value, ends in ((values.initial, reach.initial), (values.final, reach.final))
        for text in (_number(value, factor, decimals), _interval(ends, factor, decimals))
    ]
    return ScoreRow(name, unit, *printed)


def _number(value: float | None, factor: float, decimals: int) -> str:
    return MISSING if value is None else fixed(value * factor, decimals)


def _interval(ends: Sequence[float | None], factor: float, decimals: int) -> str:
    """Print an interval, or the end of it that is known; empty where neither is."""
    if not ends or not is_number(ends[0]):
        return ""
    if not is_number(ends[1]):
        return f"above {_number(ends[0], factor, decimals)}"
    return f"{NARROW_SPACE}to{NARROW_SPACE}".join(_number(end, factor, decimals) for end in ends)


router = PageRouter()

LEVEL_OF_ANSWER = {"YES": "caution", "NOT YET": "normal", "MORE DATA NEEDED": "standby"}
LEVEL_OF_DRIFT = {"DRIFT": "serious", "GROUND SHIFT": "caution", "HOLDS": "normal", "NOT TESTED": "off"}


@router.get("/sensors/{sensor_id:int}/trend", response_class=HTMLResponse, dependencies=[KNOWN])
def trend_page(request: Request, session: Reading, sensor_id: int) -> HTMLResponse:
    """Show a sensor over the mission."""
    return _trend(request, sensor_id, {}, None, session)


def _trend(
    request: Request, sensor_id: int, typed: Mapping[str, str], refusal: RefusalContext | None, session: Session
) -> HTMLResponse:
    document = make_trend_document(session, sensor_id)
    return render(
        request,
        "fleet/trend.html",
        refused=refusal,
        refusal=refusal.sentence if refusal else "",
        typed=typed,
        now=utc_now()[:19] + "Z",
        sensor=session.get_known(Sensor, sensor_id),
        trend=document,
        models=[None, *dict.fromkeys(point.camera_model for point in document.others)],
        figure=figure,
        rows=_rows(document.drift, document.baselines[-1].parameters if document.baselines else {}),
        points=[*document.points, *document.others][::-1],
        open_alarms=alarms.list_alarms(session, alarms.AlarmFilter(sensor_id=sensor_id)),
        answer_level=LEVEL_OF_ANSWER[document.advice.answer],
        drift_level=LEVEL_OF_DRIFT[document.drift.verdict],
    )


def _rows(drift: Drift, baseline: Mapping[str, float | None]) -> Sequence[Mapping[str, Any]]:
    """Return the drift of each tested parameter: the change with its sigma, and the slope with its own."""
    if drift.difference is None or drift.sigma is None:
        return []
    slope, sigma = drift.slope_per_day or Values(), drift.slope_sigma_per_day or Values()
    return [
        {
            "name": name,
            "difference": drift.difference[name],
            "sigma": drift.sigma[name],
            "power": power(name, baseline.get(name), drift.difference[name], drift.sigma[name]),
            "worth": drift.difference[name] / drift.sigma[name],
            "slope": slope.get(name),
            "slope_sigma": sigma.get(name),
        }
        for name in drift.names
    ]


RUNS_SHOWN, SETS_SHOWN = 10, 100

sensor_router = PageRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class BaselineValue:
    """One parameter of the baseline."""

    name: str
    value: float
    sigma: float | None
    ground: float | None
    typical_sigma: float | None
    truth: float | None


def baseline_values(sensor: Sensor, baseline: ParameterSet | None) -> list[BaselineValue]:
    """Lay out the baseline's parameters in model order; a ground calibration has no measured sigma."""
    document, found = sensor.document, parse_parameter_set(baseline.document) if baseline else None
    values = found.parameters if found else document["initial"]
    measured = baseline is not None and baseline.run_id is not None
    sigma = found.reliable_sigma if found and measured else Values()
    return [
        BaselineValue(
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
    """The baseline and the set on board at a time, or why they are not known."""

    time: str
    baseline: ParameterSet | None
    onboard: Sequence[tuple[ParameterSet, Uplink]]
    refusal: str | None
    code: str = ""


def _read_as_of(session: Session, sensor_id: int, time: str) -> AsOf | None:
    if not time.strip():
        return None
    try:
        baseline = uplinks.find_baseline_at(session, sensor_id, time.strip())
        return AsOf(time, baseline, uplinks.list_onboard_at(session, sensor_id, time.strip()), None)
    except RefusedInputError as refusal:
        return AsOf(time, None, (), str(refusal), refusal.code)


UNDECLARED = "not declared: add it to the sensor file below"


def describe_declarations(document: Mapping[str, Any]) -> dict[str, str]:
    """Say by title what a sensor file declares that no data can show, and what nobody declared."""
    sensor = parse_sensor(document)
    words = {"Readout": UNDECLARED if sensor.readout is None else sensor.readout.words}
    if sensor.site is not None:
        site = sensor.site.document()
        words["Site"] = "; ".join(f"{SITE_FIELDS[name].label} {value:g}" for name, value in site.items())
    declared = sensor.declared.document()
    return words | {
        one.title: ", ".join(filter(None, (f"{declared[name]}: {one.words[declared[name]]}", one.condition)))
        if name in declared
        else UNDECLARED
        for name, one in DECLARATIONS.items()
        if name in declared or one.is_asked(CAMERA_MODELS[sensor.camera_model])
    }


@dataclass(frozen=True)
class SensorContext:
    """The state of the edit form."""

    text: str = ""
    refusal: RefusalContext | None = None


def _page(request: Request, actor: Actor, sensor_id: int, at: str, shown: SensorContext) -> HTMLResponse:
    with open_reading(get_server(request).engine) as session:
        sensor, baseline = session.get_known(Sensor, sensor_id), set_queries.find_baseline(session, sensor_id)
        newest = runs.list_runs(session, sensor_id=sensor_id, limit=RUNS_SHOWN)
        names = read_names(session, newest)
        sets = lists.list_newest(session, ParameterSet, sensor=sensor_id, limit=SETS_SHOWN)
        promotions = set_queries.list_promotions(session, sensor_id)
        promoted = set_queries.read_heads(session, {one.parameter_set_id for one in promotions})
        values = baseline_values(sensor, baseline)
        advice = advise(read_trend(session, sensor_id))
        return render(
            request,
            "fleet/sensor.html",
            refused=shown.refusal,
            sensor=sensor,
            tile=list_fleet_tiles(session, [sensor_id])[0],
            names=names,
            baseline=baseline,
            verdict_of_baseline=gates.read_verdicts(session, [baseline.id]).get(baseline.id) if baseline else None,
            values=values,
            has_truth=bool(sensor.truth),
            measured=baseline is not None and baseline.run_id is not None,
            optics=compute_optics(
                CAMERA_MODELS[sensor.document["camera_model"]],
                sensor.document["detector"],
                {it.name: it.value for it in values},
            ),
            sets=sets,
            set_names={number: head.name for number, head in promoted.items()},
            advice=advice,
            answer_level=LEVEL_OF_ANSWER[advice.answer],
            open_alarms=alarms.list_alarms(session, alarms.AlarmFilter(sensor_id=sensor_id)),
            notes=notes.list_notes(session, "sensors", sensor_id),
            promotions=promotions,
            telemetry=telemetry_sets.list_telemetry_sets(session, sensor_id=sensor_id, limit=SETS_SHOWN),
            sets_in_all=lists.count(session, "parameter-sets", {"sensor": sensor_id}),
            telemetry_in_all=lists.count(session, "telemetry", {"sensor": sensor_id, "in_use": True}),
            runs=[make_run_line(run, names) for run in newest],
            change=before_after(session, get_server(request).blobs, sensor_id),
            as_of=_read_as_of(session, sensor_id, at),
            now=utc_now(),
            declarations=describe_declarations(sensor.document),
            file_text=shown.text or json.dumps(sensor.document, indent=2),
            may_edit=bool({"analyst", "administrator"} & actor.roles),
            shown=shown,
        )


@sensor_router.get("/sensors/{sensor_id}", response_class=HTMLResponse)
def sensor_page(request: Request, actor: Who, sensor_id: int, at: str = "") -> HTMLResponse:
    """Show a sensor, and what was baseline and on board at a time where asked."""
    return _page(request, actor, sensor_id, at, SensorContext())


@sensor_router.post("/sensors/{sensor_id}", response_class=HTMLResponse)
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
        return redirect(
            f"/sensors/{sensor_id}", flash=f"{outcome.value.name} is changed; new runs start from this file."
        )
    return await run_in_threadpool(_page, request, actor, sensor_id, "", SensorContext(document, outcome.refusal))


def _edit(actor: Actor, sensor_id: int, text: str, version: int | None, session: Session) -> Sensor:
    return sensors.edit_sensor(session, actor, sensor_id, read_document(text), version)


@sensor_router.post("/sensors/{sensor_id:int}/annotations", response_class=HTMLResponse)
async def annotate(
    request: Request, actor: Who, sensor_id: int, at: Annotated[str, Form()] = "", text: Annotated[str, Form()] = ""
) -> Response:
    """Say something of a time of the mission; it stands on the trend."""
    change = partial(notes.annotate, actor=actor, sensor_id=sensor_id, at=at, text=text)
    again = partial(_trend, request, sensor_id, {"at": at, "text": text})
    address = f"/sensors/{sensor_id}/trend#annotations"
    return await make_change(request, change, address, "Your annotation was added to the trend.", again=again)


EVENTS_A_PAGE = 50


@router.get("/sensors/{sensor_id:int}/timeline", response_class=HTMLResponse)
def timeline_page(
    request: Request, session: Reading, actor: Who, sensor_id: int, at: str = "", before: str = ""
) -> HTMLResponse:
    """Show the state of a sensor at a time, by default now, and its events."""
    sensor = session.get_known(Sensor, sensor_id)
    answer, refusal = _answer(session, sensor_id, at.strip())
    before_id = parse_row_id(before)
    found = timeline.list_events(session, sensor_id, before_id=before_id, limit=EVENTS_A_PAGE + 1)
    events = found[:EVENTS_A_PAGE]
    return render(
        request,
        "fleet/timeline.html",
        status_code=422 if refusal else 200,
        sensor=sensor,
        at=at.strip(),
        now=utc_now(),
        known=answer,
        refusal=refusal,
        events=events,
        later=before_id is not None,
        older=events[-1].id if len(found) > EVENTS_A_PAGE else None,
        names=read_names(session),
        actor=actor,
    )


def _answer(session: Session, sensor_id: int, at: str) -> tuple[timeline.AsOf | None, RefusedInputError | None]:
    try:
        return timeline.get_state_at(session, sensor_id, at or None), None
    except RefusedInputError as error:
        return None, error
