"""Sensors: register, read, edit; what was baseline and what was on board at a time."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Query
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing, etag
from boresight.api.keeping import Known, whole_tag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.services import lists, sensors, uplinks

router = APIRouter(prefix="/sensors", tags=["sensors"])

EXAMPLE = {
    "name": "ST-1",
    "detector": {"rows": 1944, "columns": 2592, "pixel_pitch_m": 2.2e-6},
    "camera_model": "pinhole_radial",
    "parity": 1,
    "centroid_sigma_px": 0.15,
    "initial": {"s": 1.0, "f_m": 0.016, "u0_px": 1295.5, "v0_px": 971.5, "k1": 0.0, "k2": 0.0},
    "typical_sigma": {"s": 1e-3, "f_m": 1e-4, "u0_px": 20.0, "v0_px": 20.0, "k1": 0.05, "k2": 0.5},
}
SensorFile = Annotated[schemas.Document, Body(description="The sensor file.", examples=[EXAMPLE])]


def _shown(row: Any, status: int = 200, **headers: str) -> Answer:
    return Answer(schemas.written(schemas.Sensor, row), status, {"ETag": etag(row.version), **headers})


@router.get("", name="list_sensors", summary="List the fleet", response_model=Page[schemas.Sensor])
def list_sensors(known: Known, session: Reading, page: Paged) -> Response:  # noqa: ARG001 - asked for what it refuses
    """List the fleet by name."""
    found = lists.page_of(session, "sensors", {}, "sensor", before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, lambda row: schemas.written(schemas.Sensor, row)))


@router.post(
    "",
    name="register_sensor",
    summary="Register a sensor",
    status_code=201,
    response_model=schemas.Sensor,
    responses=refusals(409),
)
def register_sensor(document: SensorFile, actor: Who, once: Idempotent, session: Writing) -> Response:
    """Add a star tracker. Its initial parameters become `PS-<sensor>-0`, the baseline."""

    def act() -> Answer:
        row = sensors.register_sensor(session, actor, document)
        return _shown(row, 201, Location=f"/api/v1/sensors/{row.id}")

    return once.answer(session, actor, act)


@router.get(
    "/{sensor_id}",
    name="get_sensor",
    summary="Read a sensor",
    response_model=schemas.Sensor,
    responses=refusals(404),
)
def get_sensor(sensor_id: Id, known: Known, session: Reading, request: Request) -> Response:  # noqa: ARG001 - asked for what it refuses
    """Read a sensor with its file; the ETag is for `PUT`."""
    whole_tag(request)
    return _shown(sensors.get_sensor(session, sensor_id)).response()


@router.put(
    "/{sensor_id}",
    name="edit_sensor",
    summary="Edit a sensor",
    response_model=schemas.Sensor,
    responses=refusals(404, 412, 428),
)
def edit_sensor(sensor_id: Id, document: SensorFile, actor: Who, seen: SeenVersion, session: Writing) -> Response:
    """Replace the sensor file for runs launched from now on. Name, model, detector and parity stay."""
    return _shown(sensors.edit_sensor(session, actor, sensor_id, document, seen)).response()


@router.get(
    "/{sensor_id}/history",
    name="get_sensor_at",
    summary="What held at a time",
    response_model=schemas.SensorAt,
    responses=refusals(404),
)
def get_sensor_at(
    sensor_id: Id,
    at: Annotated[str, Query(description="ISO 8601, UTC.", examples=["2026-11-21T03:04:05Z"])],
    known: Known,  # noqa: ARG001 - asked for what it refuses
    session: Reading,
) -> Response:
    """Say what was the sensor's baseline at a time, and what was recorded on board."""
    sensors.get_sensor(session, sensor_id)
    baseline = uplinks.baseline_at(session, sensor_id, at)
    onboard = [
        {"parameter_set": row.name, "sha256": row.sha256, "record": schemas.written(schemas.Uplink, record)}
        for row, record in uplinks.onboard_at(session, sensor_id, at)
    ]
    shown = None if baseline is None else schemas.written(schemas.ParameterSet, baseline)
    return json_response({"at": at, "baseline": shown, "onboard": onboard})
