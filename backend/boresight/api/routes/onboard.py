"""Transitions of a set on board that no statement makes: a read-back, and the signed entry that it is active.

A dump is small, so its form is read whole, under the limit that the border sets for every body.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends
from pydantic import BaseModel, ConfigDict, Field, SecretStr
from starlette.datastructures import UploadFile
from starlette.requests import Request

from boresight.api import schemas
from boresight.api.credentials import who_acts
from boresight.api.dependencies import Blobs, SeenVersion, Who, Writing, own_password
from boresight.api.numbers import Id
from boresight.api.operation import FORM_CONTENT, operations
from boresight.services import read_backs, uplinks
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.store.tables import Uplink

router = operations("/parameter-sets", tags=["uplinks"])

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

    def content(self) -> bytes:
        """Return what came, to be digested: a form's text differs from one sending to the next, this does not."""
        return repr((self.source, self.crc, self.happened)).encode() + hashlib.sha256(self.dump or b"").digest()


async def read_form(
    request: Request,
    actor: Annotated[Actor, Depends(who_acts)],  # noqa: ARG001 - nothing is read for nobody
) -> ReadBack:
    """Read the form; what is no file is a text, and a field that is left out is an empty one."""
    async with request.form(max_files=1, max_fields=MOST_FIELDS) as form:
        file = form.get("file")
        dump = await file.read() if isinstance(file, UploadFile) and file.filename else None
        texts = {name: value for name, value in form.items() if isinstance(value, str)}
    came = ReadBack(texts.get("source", ""), texts.get("crc", ""), texts.get("happened_utc", ""), dump)
    setattr(request.state, FORM_CONTENT, came.content)
    return came


@router.post(
    "/{parameter_set_id}:read-back",
    summary="Compare a dump or a CRC",
    status_code=201,
    response_model=schemas.Uplink,
    openapi_extra={"requestBody": FORM},
)
def read_back(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    came: Annotated[ReadBack, Depends(read_form)],
    session: Writing,
    blobs: Blobs,
) -> Uplink:
    """Hold the dump of the table, or the CRC that the spacecraft told, against what was sent.

    Records VERIFIED (`method` says by what), or MISMATCH with the differing bytes and fields in `evidence`.
    """
    read = read_backs.dump_or_crc(came.dump, came.crc)
    return read_backs.read_back(session, actor, blobs, parameter_set_id, read, came.source, seen, came.happened)


class Activation(BaseModel):
    """The signed entry that a set is what the sensor runs with."""

    model_config = ConfigDict(extra="forbid")
    source: str = Field(description="Where it is known from.", examples=["TM page STR-2, pass 4711"])
    meaning: str = Field(description="What the signature means.", examples=["I saw this table active in telemetry."])
    password: SecretStr = Field(description="Once more: the signature is of the person, not of the log-in.")
    happened_utc: str | None = Field(None, description="When it became active, where that is earlier.")


@router.post(
    "/{parameter_set_id}:activate", summary="Sign that it is active", status_code=201, response_model=schemas.Uplink
)
def activate_parameter_set(
    parameter_set_id: Id,
    signed: Activation,
    actor: Who,
    seen: SeenVersion,
    proof: Annotated[PasswordProof, own_password(Activation)],
    session: Writing,
) -> Uplink:
    """Record a verified set as ACTIVE, signed by an operator in person; the set that was active becomes UNKNOWN."""
    return uplinks.activate(
        session,
        actor,
        parameter_set_id,
        signed.source,
        signed.meaning,
        proof,
        seen,
        happened=signed.happened_utc,
    )
