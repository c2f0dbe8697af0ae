"""Operations on sensors: register, read, edit, what held at a time, every event, the trend, and what to observe next."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any

from fastapi import Body, Query
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.calibration.calibration import to_plain
from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA
from boresight.console import list_queries as lists
from boresight.console import schemas as console_schemas
from boresight.console.access.dependencies import (
    SAME_FOR_ALL,
    Blobs,
    Database,
    IsDryRun,
    Reading,
    SeenVersion,
    Stars,
    Who,
    Writing,
)
from boresight.console.fleet import pointings, schemas, timeline
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.timeline import TimelineEvent
from boresight.console.fleet.trend_document import make_trend_document
from boresight.console.operation import RowWithFields, json_response, operations
from boresight.console.runs import schemas as run_schemas
from boresight.console.uplinks import schemas as uplink_schemas
from boresight.console.uplinks import service as uplinks
from boresight.errors import RefusedInputError
from boresight.figures import figure_json, trend
from boresight.platform.db.sessions import open_reading
from boresight.platform.web.media import CsvFile, csv_response
from boresight.platform.web.openapi import refuses
from boresight.platform.web.paging import Id, Listing, Page, Paged
from boresight.platform.web.response_cache import cover_with_tag
from boresight.simulation.plans import PointingPlan
from boresight.simulation.pointings import Constraints, Criterion
from boresight.telemetry.declarations import DECLARATIONS

router = operations("/sensors", tags=["sensors"])

EXAMPLE = {
    "name": "ST-1",
    "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
    "camera_model": DEFAULT_CAMERA.name,
    "parity": 1,
    "centroid_sigma_px": 0.15,
    "initial": schemas.EXAMPLE_INITIAL,
    "typical_sigma": schemas.EXAMPLE_TYPICAL_SIGMA,
    "readout": schemas.EXAMPLE_READOUT,
    "declared": schemas.EXAMPLE_DECLARED,
}
_ABOUT_FILE = (
    "The sensor file. What no data can show is declared in `readout` (`mode` global or rolling, `line_time_s`, `axis` rows or "
    "columns, `corrected`) and `declared` ("
    + ", ".join(f"`{name}` {' or '.join(one.words)}" for name, one in DECLARATIONS.items())
    + "); `site` is where on the ground a camera stands. Until it is declared the gate `assumptions` has no data."
)
SensorFile = Annotated[console_schemas.Document, Body(description=_ABOUT_FILE, examples=[EXAMPLE])]


@router.get("", summary="List the fleet", response_model=Page[schemas.Sensor], dependencies=[SAME_FOR_ALL])
def list_sensors(session: Reading, page: Paged) -> Listing[Sensor]:
    """List the fleet by name."""
    return page.cut(lists.read_page(session, "sensors", {}, "sensor", before_id=page.last_id, limit=page.limit + 1))


@router.post("", summary="Register a sensor", status_code=201, response_model=schemas.Sensor)
def register_sensor(document: SensorFile, actor: Who, session: Writing) -> Sensor:
    """Add a star tracker. Its initial parameters become `PS-<sensor>-0`, the baseline."""
    return sensors.register_sensor(session, actor, document)


@router.get("/{sensor_id}", summary="Read a sensor", response_model=schemas.Sensor, dependencies=[SAME_FOR_ALL])
def get_sensor(sensor_id: Id, session: Reading, request: Request) -> Sensor:
    """Read a sensor with its file; the ETag is needed for `PUT`."""
    cover_with_tag(request)
    return session.get_known(Sensor, sensor_id)


@router.put("/{sensor_id}", summary="Edit a sensor", response_model=schemas.Sensor)
def edit_sensor(sensor_id: Id, document: SensorFile, actor: Who, seen: SeenVersion, session: Writing) -> Sensor:
    """Replace the sensor file for runs launched from now on. Name, model, detector and parity stay."""
    return sensors.edit_sensor(session, actor, sensor_id, document, seen)


@router.get(
    "/{sensor_id}/history",
    summary="What was in force at a time",
    response_model=schemas.SensorAt,
    dependencies=[SAME_FOR_ALL],
)
def get_sensor_at(
    sensor_id: Id,
    at: Annotated[str, Query(description="ISO 8601, UTC.", examples=["2026-11-21T03:04:05Z"])],
    session: Reading,
) -> dict[str, Any]:
    """Say what was the sensor's baseline at a time, and what was recorded on board."""
    session.get_known(Sensor, sensor_id)
    baseline, onboard = (
        uplinks.find_baseline_at(session, sensor_id, at),
        uplinks.list_onboard_at(session, sensor_id, at),
    )
    return {"at": at, "baseline": baseline, "onboard": _on_board(onboard)}


Time = Annotated[str | None, Query(description="ISO 8601, UTC; now if omitted.", examples=["2026-11-21T03:04:05Z"])]


@router.get(
    "/{sensor_id}/as-of",
    summary="What was in force at a time, with sources",
    response_model=uplink_schemas.AsOf,
)
def get_sensor_as_of(sensor_id: Id, session: Reading, time: Time = None) -> RowWithFields:
    """Say what was baseline, what was on board, and the gate profile and table definition in force, as recorded by then.

    With the promotion, its request and signatures, and the records on board with their sources.
    """
    known = timeline.get_state_at(session, sensor_id, time)
    return RowWithFields(
        known,
        sensor_id=known.sensor.id,
        approval=known.approval and RowWithFields(known.approval, signatures=known.signatures),
        on_board=_on_board(known.on_board),
        learned_later=_on_board(known.learned_later),
        gate_profile=known.profile,
        table_definition=known.definition,
    )


def _on_board(records: timeline.Records) -> list[dict[str, Any]]:
    return [{"parameter_set": row.name, "sha256": row.sha256, "record": record} for row, record in records]


@router.get("/{sensor_id}/timeline", summary="List what happened", response_model=Page[uplink_schemas.Event])
def list_sensor_timeline(
    sensor_id: Id,
    session: Reading,
    page: Paged,
    until: Annotated[str | None, Query(description="Leave out what was recorded after this time.")] = None,
) -> Listing[TimelineEvent]:
    """List what happened to a sensor, newest first.

    Promotions and roll-backs, requests and signatures, waivers, packages, records on board and read-backs, gate profiles and
    table definitions.
    """
    return page.cut(timeline.list_events(session, sensor_id, until=until, **page.rows))


trend_router = operations("/sensors/{sensor_id}/trend", tags=["sensors"])

MODELS = ", ".join(CAMERA_MODELS)
Model = Annotated[str | None, Query(description=f"A camera model; the baseline's if omitted. One of {MODELS}.")]
IN_CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row per calibration, numbers in SI."}}


def _known(model: str | None) -> str | None:
    if model is not None and model not in CAMERA_MODELS:
        raise RefusedInputError(f"There is no camera model {model!r}; choose from {MODELS}.")
    return model


@trend_router.get("", summary="Read a sensor's trend", response_model=schemas.Trend)
def get_sensor_trend(sensor_id: Id, session: Reading) -> Response:
    """Read every calibration at the time of its data, with the baselines and the records on board.

    `drift` says whether the baseline is still valid, at 0.1 % false alarms for each test, and whether the parameters change with
    time; `advice` whether to recalibrate now. A calibration that the tests do not use says why in `left_out`.
    """
    return json_response(to_plain(make_trend_document(session, sensor_id)))


@trend_router.get("/figure", summary="Read its figure", response_model=run_schemas.PlotlyFigure)
def get_sensor_trend_figure(sensor_id: Id, session: Reading, model: Model = None) -> Response:
    """Read the trend as Plotly JSON."""
    document = make_trend_document(session, sensor_id)
    return Response(figure_json(trend.draw(document, _known(model))), media_type="application/json")


@trend_router.get("/data", summary="Read its numbers", response_class=CsvFile, responses=IN_CSV)
def get_sensor_trend_data(sensor_id: Id, session: Reading, model: Model = None) -> Response:
    """Read the numbers behind the figure as CSV."""
    return csv_response(
        trend.table(make_trend_document(session, sensor_id), _known(model)), f"sensor-{sensor_id}-trend.csv"
    )


class OrbitMeasures(console_schemas.Shape):
    """A circular orbit, for the Earth's limb."""

    altitude_km: float
    inclination_deg: float
    node_hour: float = Field(description="Local solar hour of the ascending node.")


class PlanConditions(console_schemas.Shape):
    """When, from what, and what a plan has to keep; left out, as `boresight plan` has it."""

    start_utc: str = Field(description="ISO 8601, UTC.", examples=["2026-10-01T00:00:00Z"])
    minutes: float = Field(
        description=f"Total duration; it may allow at most {pointings.MOST_DWELLS} dwells.", examples=[10.0]
    )
    criterion: Criterion = Field(
        "A", description="A: smallest sum of variances in typical sigmas. D: smallest volume of the confidence region."
    )
    prior_set_id: Id | None = Field(
        None,
        description="Approved or active parameter set that gives the prior covariance; if omitted, no prior knowledge is assumed.",
    )
    prior_run_id: Id | None = Field(None, description="The same from a finished run; give at most one of the two.")
    candidates: list[Annotated[list[float], Field(min_length=3, max_length=3)]] | None = Field(
        None,
        min_length=1,
        max_length=pointings.MOST_CANDIDATES,
        description="Attitudes that may be chosen, each as ra_deg, dec_deg, roll_deg; if omitted, the whole sky.",
    )
    orbit: OrbitMeasures | None = Field(None, description="If omitted, the Earth never obstructs the view.")
    dwell_s: float = Field(Constraints.dwell_s, description="Duration of a pointing.")
    exposure_s: float = Field(Constraints.exposure_s, description="From one exposure to the next.")
    slew_deg_s: float = Field(Constraints.slew_deg_s, description="Slew rate.")
    settle_s: float = Field(Constraints.settle_s, description="Settling time after a slew.")
    sun_deg: float = Field(Constraints.sun_deg, description="Minimum angle from the Sun.")
    moon_deg: float = Field(Constraints.moon_deg, description="Minimum angle from the Moon.")
    earth_deg: float = Field(Constraints.earth_deg, description="Minimum angle from the Earth's limb.")
    visits: int = Field(Constraints.visits, description="Maximum number of visits to a pointing.")


#: Of the conditions, those that are constraints as they stand.
KEPT = {one.name for one in fields(Constraints)} - {"start_utc", "orbit"}


@router.post("/{sensor_id}:plan", summary="Plan what to observe next", response_model=PointingPlan)
@refuses(404, 409, 503)
def plan_pointings(
    sensor_id: Id, conditions: PlanConditions, asked: IsDryRun, engine: Database, blobs: Blobs, stars: Stars
) -> Response:
    """Choose the pointings and rolls that shrink what is known least, by the minute, clear of Sun, Moon and Earth.

    The answer has them in order, with the sigmas before and after and when the gate of observability is passed. Nothing is stored
    in any case; plans are computed one at a time, and who comes while others wait is told to come back (503).
    """
    constraints = pointings.read_constraints(
        conditions.start_utc,
        None if conditions.orbit is None else conditions.orbit.model_dump(),
        conditions.model_dump(include=KEPT),
    )
    candidates = pointings.read_candidates(conditions.candidates)
    with open_reading(engine) as session:
        sensor = session.get_known(Sensor, sensor_id)
        known = pointings.read_known(session, blobs, sensor, conditions.prior_run_id, conditions.prior_set_id)
        document = sensor.document
    found = pointings.compute(document, known, candidates, constraints, conditions.criterion, stars)
    return json_response(found.to_dict(), headers={"X-Validate-Only": "true"} if asked else None)
