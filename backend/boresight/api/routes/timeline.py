"""A sensor's history: what held at a time and who said so, and every event in order."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import json_response
from boresight.api.dependencies import Reading, Who
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.schemas import written
from boresight.services import timeline
from boresight.store.tables import GateProfile, TableDefinition

router = APIRouter(prefix="/sensors", tags=["sensors"])

Time = Annotated[str | None, Query(description="ISO 8601, UTC; now when left out.", examples=["2026-11-21T03:04:05Z"])]


@router.get(
    "/{sensor_id}/as-of",
    name="get_sensor_as_of",
    summary="What held at a time, and who said so",
    response_model=schemas.AsOf,
    responses=refusals(404),
)
def get_sensor_as_of(
    sensor_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    time: Time = None,
) -> Response:
    """Say what was baseline, what was on board, and the gate profile and table definition in force, as recorded by then.

    With the promotion, its request and signatures, and the records on board with their sources.
    """
    return json_response(_shown(timeline.as_of(session, sensor_id, time)))


def _shown(known: timeline.AsOf) -> schemas.Document:
    """Write what held at a time."""
    baseline, promotion = known.baseline, known.promotion
    return {
        "sensor_id": known.sensor.id,
        "time_utc": known.time_utc,
        "sentence": known.sentence,
        "differs": known.differs,
        "baseline": None if baseline is None else written(schemas.ParameterSet, baseline),
        "promotion": None if promotion is None else written(schemas.Promotion, promotion),
        "approval": _approval(known),
        "on_board": _on_board(known.on_board),
        "learned_later": _on_board(known.learned_later),
        "gate_profile": _version(known.profile),
        "table_definition": _version(known.definition),
    }


def _approval(known: timeline.AsOf) -> schemas.Document | None:
    if known.approval is None:
        return None
    signatures = [written(schemas.Signature, signature) for signature in known.signatures]
    return {**written(schemas.Approval, known.approval), "signatures": signatures}


def _on_board(records: timeline.Records) -> list[schemas.Document]:
    return [
        {"parameter_set": row.name, "sha256": row.sha256, "record": written(schemas.Uplink, record)}
        for row, record in records
    ]


def _version(row: GateProfile | TableDefinition | None) -> schemas.Document | None:
    return None if row is None else written(schemas.Version, row)


@router.get(
    "/{sensor_id}/timeline",
    name="list_sensor_timeline",
    summary="List what happened",
    response_model=Page[schemas.Event],
    responses=refusals(404),
)
def list_sensor_timeline(
    sensor_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    until: Annotated[str | None, Query(description="Leave out what was recorded after this time.")] = None,
) -> Response:
    """List what happened to a sensor, newest first.

    Promotions and roll-backs, requests and signatures, waivers, packages, records on board and read-backs, gate profiles and
    table definitions.
    """
    found = timeline.events(session, sensor_id, until=until, before_id=page.last_id, limit=page.limit + 1)
    return json_response(page.cut(found, lambda event: written(schemas.Event, event)))
