"""Uplinks: what people recorded of a parameter set on board.

By statement, or signed where the body carries a password and a meaning: then it is the entry that `:activate` makes.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, Idempotent, json_response
from boresight.api.dependencies import Reading, SeenVersion, Who, Writing, check_own
from boresight.api.media import StoredFile
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.api.paging import Page, Paged
from boresight.errors import RefusedInputError
from boresight.services import uplinks
from boresight.services.actors import Actor
from boresight.services.passwords import NO_PROOF, PasswordProof
from boresight.store.sessions import Session
from boresight.store.tables import Uplink

router = APIRouter(prefix="/uplinks", tags=["uplinks"])


class Record(BaseModel):
    """A step on board, and where it is known from."""

    model_config = ConfigDict(extra="forbid")
    parameter_set_id: Id
    onboard_state: str = Field(examples=["SENT"])
    source: str = Field(
        description="The pass, the procedure or the read-back file.", examples=["Pass 4711, TC log line 88"]
    )
    package_id: Id | None = Field(None, description="The uplink package that was sent, where one was built.")
    happened_utc: str | None = Field(None, description="When it happened, where that is earlier than now.")
    meaning: str | None = Field(None, description="Of ACTIVE: what the signature means.")
    password: str | None = Field(None, description="Of ACTIVE: once more, for the signature is of the person.")

    @property
    def signed(self) -> bool:
        """Whether it comes with anything of a signature."""
        return self.password is not None or self.meaning is not None


def _entry(session: Session, actor: Actor, record: Record, proof: PasswordProof, seen: int | None) -> Uplink:
    """Make the entry: a signed one as `:activate` does, any other by statement."""
    set_id, state, source, happened = record.parameter_set_id, record.onboard_state, record.source, record.happened_utc
    if not record.signed:
        return uplinks.record(
            session, actor, set_id, state, source, seen, package_id=record.package_id, happened=happened
        )
    if state != "ACTIVE" or record.package_id is not None:
        raise RefusedInputError(
            "Only ACTIVE is signed, and of a package that was named before; leave out password and meaning, or the package."
        )
    return uplinks.activate(session, actor, set_id, source, record.meaning or "", proof, seen, happened=happened)


async def proven_own(record: Record, actor: Who, request: Request) -> tuple[Record, PasswordProof]:
    """Check the password of who acts, where the entry is signed, before any transaction begins."""
    return record, await check_own(request, actor, record.password) if record.password else NO_PROOF


@router.get("", name="list_uplinks", summary="List records", response_model=Page[schemas.Uplink])
def list_uplinks(
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    page: Paged,
    parameter_set_id: Id | None = None,
    sensor_id: Id | None = None,
) -> Response:
    """List what was recorded, newest first."""
    found = uplinks.list_uplinks(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=page.last_id, limit=page.limit + 1
    )
    return json_response(page.cut(found, lambda row: schemas.written(schemas.Uplink, row)))


@router.post(
    "",
    name="record_uplink",
    summary="Record a step on board",
    status_code=201,
    response_model=schemas.Uplink,
    responses=refusals(404, 409, 412, 428, 429),
)
def record_uplink(
    actor: Who,
    seen: SeenVersion,
    proven: Annotated[tuple[Record, PasswordProof], Depends(proven_own)],
    once: Idempotent,
    session: Writing,
) -> Response:
    """Record the next on-board state of a set by statement: SENT, LOADED, MISMATCH or UNKNOWN.

    `If-Match` is the ETag of the parameter set. VERIFIED comes only of `:read-back` of the set, which compares; ACTIVE only
    of a signed entry: `:activate`, or this with the password and the meaning of a person.
    """

    def act() -> Answer:
        row = _entry(session, actor, *proven, seen)
        return Answer(schemas.written(schemas.Uplink, row), 201, {"Location": f"/api/v1/uplinks/{row.id}"})

    return once.answer(session, actor, act)


@router.get(
    "/{uplink_id}", name="get_uplink", summary="Read a record", response_model=schemas.Uplink, responses=refusals(404)
)
def get_uplink(uplink_id: Id, actor: Who, session: Reading) -> Response:  # noqa: ARG001 - whoever is known may read
    """Read a record with its evidence."""
    return json_response(schemas.written(schemas.Uplink, uplinks.get_uplink(session, uplink_id)))


@router.get(
    "/{uplink_id}/dump",
    name="get_uplink_dump",
    summary="Download the dump",
    response_class=StoredFile,
    responses=refusals(404, 409),
)
def get_uplink_dump(
    uplink_id: Id,
    actor: Who,  # noqa: ARG001 - whoever is known may read
    session: Reading,
    request: Request,
) -> StoredFile:
    """Download the bytes that a read-back compared, as they were uploaded."""
    sha256 = uplinks.dump_of(session, uplink_id)
    path = request.app.state.blobs.path(sha256)
    return StoredFile(path, filename=f"uplink-{uplink_id}-dump.bin", headers={"ETag": f'"{sha256}"'})
