"""Table definitions of a sensor: how its camera lies in the table on board, in force and before."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from boresight.api import schemas
from boresight.api.dependencies import Held, Reading, SeenVersion, Who, Writing
from boresight.api.numbers import Id
from boresight.api.operation import Answer, operations
from boresight.api.paging import Page, Paged
from boresight.api.routes.change_proposals import PROPOSED, in_force_or_proposed
from boresight.services import second_person, table_definitions
from boresight.store.tables import GateProfile, TableDefinition

router = operations("/sensors", tags=["uplinks"])

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
    summary="List the table definitions of a sensor",
    response_model=Page[schemas.TableDefinition],
)
def list_table_definitions(sensor_id: Id, session: Reading, page: Paged) -> Answer:
    """List every version, newest first; the first is in force, and the ETag is for setting another, `"v0"` for none."""
    found = table_definitions.list_definitions(session, sensor_id)
    tag = schemas.TableDefinition.etag(found[0]) if found else '"v0"'
    return Answer(page.cut_whole(found), headers={"ETag": tag})


@router.post(
    "/{sensor_id}/table-definitions",
    summary="Set the table definition of a sensor",
    status_code=201,
    response_model=schemas.TableDefinition,
    responses=PROPOSED,
)
def set_table_definition(
    sensor_id: Id, definition: NewTableDefinition, actor: Who, seen: SeenVersion, policy: Held, session: Writing
) -> GateProfile | TableDefinition | Answer:
    """Put another layout into force. The sensor's undecided requests become STALE, for they would be other bytes.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and moves nothing until another
    analyst or administrator confirms it.
    """
    made = second_person.change(
        session,
        actor,
        "table-definition",
        sensor_id,
        definition.document,
        definition.reason,
        seen,
        policy=policy,
    )
    return in_force_or_proposed(session, made)
