"""Transitions of a set on board that no statement makes: a read-back, and the signed entry that it is active.

A dump is small, so its form is read whole, under the limit that the border sets for every body.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, ConfigDict, Field
from starlette.datastructures import UploadFile
from starlette.requests import Request
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.answers import Answer, IdempotencyKey, Idempotent, Once, digest
from boresight.api.credentials import who_acts
from boresight.api.dependencies import OnlyAsked, SeenVersion, Who, Writing, check_own
from boresight.api.numbers import Id
from boresight.api.openapi import refusals
from boresight.services import read_backs, uplinks
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof

router = APIRouter(prefix="/parameter-sets", tags=["uplinks"])

MOST_FIELDS = 10
FORM = {
    "required": True,
    "content": {
        "multipart/form-data": {
            "schema": {
                "type": "object",
                "required": ["source"],
                "properties": {
                    "source": {"type": "string", "description": "The pass, the procedure or the packet."},
                    "file": {"type": "string", "format": "binary", "description": "The dump of the table."},
                    "crc": {"type": "string", "description": "Or the CRC that was told, in hexadecimal."},
                    "happened_utc": {"type": "string", "description": "When it was read, where that is earlier."},
                },
            }
        }
    },
}


@dataclass(frozen=True)
class ReadBack:
    """What came: the fields, and the dump if there was one."""

    source: str
    crc: str
    happened: str
    dump: bytes | None


async def read_form(
    request: Request,
    actor: Annotated[Actor, Depends(who_acts)],  # noqa: ARG001 - nothing is read for nobody
) -> ReadBack:
    """Read the form; what is no file is a text, and a field that is left out is an empty one."""
    async with request.form(max_files=1, max_fields=MOST_FIELDS) as form:
        file = form.get("file")
        dump = await file.read() if isinstance(file, UploadFile) and file.filename else None
        texts = {name: value for name, value in form.items() if isinstance(value, str)}
    return ReadBack(texts.get("source", ""), texts.get("crc", ""), texts.get("happened_utc", ""), dump)


Came = Annotated[ReadBack, Depends(read_form)]


def once_read(request: Request, came: Came, asked: OnlyAsked, idempotency_key: IdempotencyKey = None) -> Once:
    """Read the key, and digest what came: a form's text differs from one sending to the next, its content does not."""
    content = repr((came.source, came.crc, came.happened)).encode() + hashlib.sha256(came.dump or b"").digest()
    return Once(idempotency_key, "" if idempotency_key is None else digest(request, content), asked)


@router.post(
    "/{parameter_set_id}:read-back",
    name="read_back",
    summary="Compare a dump or a CRC",
    status_code=201,
    response_model=schemas.Uplink,
    responses=refusals(400, 404, 409, 412, 413, 428),
    openapi_extra={"requestBody": FORM},
)
def read_back(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    came: Came,
    once: Annotated[Once, Depends(once_read)],
    session: Writing,
    request: Request,
) -> Response:
    """Hold the dump of the table, or the CRC that the spacecraft told, against what was sent.

    Records VERIFIED (`method` says by what), or MISMATCH with the differing bytes and fields in `evidence`.
    """

    def act() -> Answer:
        read = read_backs.dump_or_crc(came.dump, came.crc)
        blobs = request.app.state.blobs
        row = read_backs.read_back(session, actor, blobs, parameter_set_id, read, came.source, seen, came.happened)
        return Answer(schemas.written(schemas.Uplink, row), 201, {"Location": f"/api/v1/uplinks/{row.id}"})

    return once.answer(session, actor, act)


class Activation(BaseModel):
    """The signed entry that a set is what the sensor runs with."""

    model_config = ConfigDict(extra="forbid")
    source: str = Field(description="Where it is known from.", examples=["TM page STR-2, pass 4711"])
    meaning: str = Field(description="What the signature means.", examples=["I saw this table active in telemetry."])
    password: str = Field(description="Once more: the signature is of the person, not of the log-in.")
    happened_utc: str | None = Field(None, description="When it became active, where that is earlier.")


async def proven_own(entry: Activation, actor: Who, request: Request) -> tuple[Activation, PasswordProof]:
    """Check the password of who acts before any transaction begins."""
    return entry, await check_own(request, actor, entry.password)


@router.post(
    "/{parameter_set_id}:activate",
    name="activate_parameter_set",
    summary="Sign that it is active",
    status_code=201,
    response_model=schemas.Uplink,
    responses=refusals(404, 409, 412, 428, 429),
)
def activate(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    proven: Annotated[tuple[Activation, PasswordProof], Depends(proven_own)],
    once: Idempotent,
    session: Writing,
) -> Response:
    """Record a verified set as ACTIVE, signed by an operator in person; the set that was active becomes UNKNOWN."""
    entry, proof = proven

    def act() -> Answer:
        row = uplinks.activate(
            session,
            actor,
            parameter_set_id,
            entry.source,
            entry.meaning,
            proof,
            seen,
            happened=entry.happened_utc,
        )
        return Answer(schemas.written(schemas.Uplink, row), 201, {"Location": f"/api/v1/uplinks/{row.id}"})

    return once.answer(session, actor, act)
