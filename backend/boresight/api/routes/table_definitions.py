"""Table definitions of a sensor: how its camera lies in the table on board, in force and before."""

from __future__ import annotations

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing, etag
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.api.routes.change_proposals import PROPOSED, answer
from boresight.services import second_person, table_definitions
from boresight.store.tables import ChangeProposal

router = APIRouter(prefix="/sensors", tags=["uplinks"])

EXAMPLE = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "byte_order": "big",
    "length_bytes": 28,
    "fields": [{"name": "FOCAL_LENGTH", "parameter": "f_m", "offset_bytes": 0, "type": "float32"}],
    "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 26},
}


class NewTableDefinition(BaseModel):
    """A definition to put into force, and why."""

    model_config = ConfigDict(extra="forbid")
    document: schemas.Document = Field(
        description="Every parameter of the camera model lies in one field.", examples=[EXAMPLE]
    )
    reason: str = Field(examples=["Flight software 4.2.1 holds the focal length in millimetres."])


@router.get(
    "/{sensor_id}/table-definitions",
    name="list_table_definitions",
    summary="List the table definitions of a sensor",
    response_model=Page[schemas.TableDefinition],
    responses=refusals(404),
)
def list_table_definitions(
    sensor_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
) -> Response:
    """List every version, newest first; the first is in force, and the ETag is for setting another, `"v0"` for none."""
    found = table_definitions.list_definitions(session, sensor_id)
    body = page.cut_whole(found, lambda row: schemas.written(schemas.TableDefinition, row))
    return json_response(body, headers={"ETag": etag(found[0].number if found else 0)})


@router.post(
    "/{sensor_id}/table-definitions",
    name="set_table_definition",
    summary="Set the table definition of a sensor",
    status_code=201,
    response_model=schemas.TableDefinition,
    responses={**PROPOSED, **refusals(404, 409, 412, 428)},
)
def set_table_definition(
    sensor_id: Id,
    definition: NewTableDefinition,
    actor: Who,
    seen: SeenVersion,
    once: Idempotent,
    policy: Held,
    session: Writing,
) -> Response:
    """Put another layout into force. The sensor's undecided requests become STALE, for they would be other bytes.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and moves nothing until another
    analyst or administrator confirms it.
    """

    def act() -> Answer:
        asked = ("table-definition", sensor_id, definition.document, definition.reason, seen)
        row = second_person.change(session, actor, *asked, policy=policy)
        if isinstance(row, ChangeProposal):
            return answer(session, row, 202)
        headers = {"ETag": etag(row.number), "Location": f"/api/v1/sensors/{sensor_id}/table-definitions"}
        return Answer(schemas.written(schemas.TableDefinition, row), 201, headers)

    return once.answer(session, actor, act)
