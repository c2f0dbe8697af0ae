"""Sensors: register, read, edit; what was baseline and what was on board at a time."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Body, Query
from starlette.requests import Request

from boresight.api import schemas
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing
from boresight.api.keeping import SAME_FOR_ALL, whole_tag
from boresight.api.numbers import Id
from boresight.api.operation import operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import lists, sensors, uplinks
from boresight.store.tables import Sensor

router = operations("/sensors", tags=["sensors"])

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


@router.get("", summary="List the fleet", response_model=Page[schemas.Sensor], dependencies=[SAME_FOR_ALL])
def list_sensors(session: Reading, page: Paged) -> Listing[Sensor]:
    """List the fleet by name."""
    return page.cut(lists.page_of(session, "sensors", {}, "sensor", before_id=page.last_id, limit=page.limit + 1))


@router.post("", summary="Register a sensor", status_code=201, response_model=schemas.Sensor)
def register_sensor(document: SensorFile, actor: Who, session: Writing) -> Sensor:
    """Add a star tracker. Its initial parameters become `PS-<sensor>-0`, the baseline."""
    return sensors.register_sensor(session, actor, document)


@router.get("/{sensor_id}", summary="Read a sensor", response_model=schemas.Sensor, dependencies=[SAME_FOR_ALL])
def get_sensor(sensor_id: Id, session: Reading, request: Request) -> Sensor:
    """Read a sensor with its file; the ETag is for `PUT`."""
    whole_tag(request)
    return sensors.get_sensor(session, sensor_id)


@router.put("/{sensor_id}", summary="Edit a sensor", response_model=schemas.Sensor)
def edit_sensor(sensor_id: Id, document: SensorFile, actor: Who, seen: SeenVersion, session: Writing) -> Sensor:
    """Replace the sensor file for runs launched from now on. Name, model, detector and parity stay."""
    return sensors.edit_sensor(session, actor, sensor_id, document, seen)


@router.get(
    "/{sensor_id}/history",
    summary="What held at a time",
    response_model=schemas.SensorAt,
    dependencies=[SAME_FOR_ALL],
)
def get_sensor_at(
    sensor_id: Id,
    at: Annotated[str, Query(description="ISO 8601, UTC.", examples=["2026-11-21T03:04:05Z"])],
    session: Reading,
) -> dict[str, Any]:
    """Say what was the sensor's baseline at a time, and what was recorded on board."""
    sensors.get_sensor(session, sensor_id)
    baseline, onboard = uplinks.baseline_at(session, sensor_id, at), uplinks.onboard_at(session, sensor_id, at)
    records = [{"parameter_set": row.name, "sha256": row.sha256, "record": record} for row, record in onboard]
    return {"at": at, "baseline": baseline, "onboard": records}
