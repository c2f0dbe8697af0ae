"""A sensor's history: what held at a time and who said so, and every event in order."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query

from boresight.api import schemas
from boresight.api.dependencies import Reading
from boresight.api.numbers import Id
from boresight.api.operation import Beside, operations
from boresight.api.paging import Listing, Page, Paged
from boresight.services import timeline
from boresight.services.history import Event

router = operations("/sensors", tags=["sensors"])

Time = Annotated[str | None, Query(description="ISO 8601, UTC; now when left out.", examples=["2026-11-21T03:04:05Z"])]


@router.get(
    "/{sensor_id}/as-of",
    summary="What held at a time, and who said so",
    response_model=schemas.AsOf,
)
def get_sensor_as_of(sensor_id: Id, session: Reading, time: Time = None) -> dict[str, Any]:
    """Say what was baseline, what was on board, and the gate profile and table definition in force, as recorded by then.

    With the promotion, its request and signatures, and the records on board with their sources.
    """
    known = timeline.as_of(session, sensor_id, time)
    return {
        "sensor_id": known.sensor.id,
        "time_utc": known.time_utc,
        "sentence": known.sentence,
        "differs": known.differs,
        "baseline": known.baseline,
        "promotion": known.promotion,
        "approval": known.approval and Beside(known.approval, signatures=known.signatures),
        "on_board": _on_board(known.on_board),
        "learned_later": _on_board(known.learned_later),
        "gate_profile": known.profile,
        "table_definition": known.definition,
    }


def _on_board(records: timeline.Records) -> list[dict[str, Any]]:
    return [{"parameter_set": row.name, "sha256": row.sha256, "record": record} for row, record in records]


@router.get("/{sensor_id}/timeline", summary="List what happened", response_model=Page[schemas.Event])
def list_sensor_timeline(
    sensor_id: Id,
    session: Reading,
    page: Paged,
    until: Annotated[str | None, Query(description="Leave out what was recorded after this time.")] = None,
) -> Listing[Event]:
    """List what happened to a sensor, newest first.

    Promotions and roll-backs, requests and signatures, waivers, packages, records on board and read-backs, gate profiles and
    table definitions.
    """
    return page.cut(timeline.events(session, sensor_id, until=until, before_id=page.last_id, limit=page.limit + 1))
