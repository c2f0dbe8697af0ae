"""Uplinks: what people recorded of a parameter set on board.

By statement, or signed where the body carries a password and a meaning: then it is the entry that `:activate` makes.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, SecretStr

from boresight.api import schemas
from boresight.api.dependencies import Blobs, Reading, SeenVersion, Who, Writing, own_password
from boresight.api.media import StoredFile
from boresight.api.numbers import Id
from boresight.api.operation import operations
from boresight.api.paging import Listing, Page, Paged
from boresight.errors import RefusedInputError
from boresight.services import uplinks
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.store.sessions import Session
from boresight.store.tables import Uplink

router = operations("/uplinks", tags=["uplinks"])


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
    password: SecretStr | None = Field(None, description="Of ACTIVE: once more, for the signature is of the person.")

    @property
    def signed(self) -> bool:
        """Whether it comes with anything of a signature."""
        return self.password is not None or self.meaning is not None


def _entry(session: Session, actor: Actor, record: Record, proof: PasswordProof, seen: int | None) -> Uplink:
    """Make the entry: a signed one as `:activate` does, any other by statement."""
    set_id, happened = record.parameter_set_id, record.happened_utc
    if not record.signed:
        return uplinks.record(
            session,
            actor,
            set_id,
            record.onboard_state,
            record.source,
            seen,
            package_id=record.package_id,
            happened=happened,
        )
    if record.onboard_state != "ACTIVE" or record.package_id is not None:
        raise RefusedInputError(
            "Only ACTIVE is signed, and of a package that was named before; leave out password and meaning, or the package."
        )
    return uplinks.activate(session, actor, set_id, record.source, record.meaning or "", proof, seen, happened=happened)


@router.get("", summary="List records", response_model=Page[schemas.Uplink])
def list_uplinks(
    session: Reading, page: Paged, parameter_set_id: Id | None = None, sensor_id: Id | None = None
) -> Listing[Uplink]:
    """List what was recorded, newest first."""
    found = uplinks.list_uplinks(
        session, parameter_set_id=parameter_set_id, sensor_id=sensor_id, before_id=page.last_id, limit=page.limit + 1
    )
    return page.cut(found)


@router.post("", summary="Record a step on board", status_code=201, response_model=schemas.Uplink)
def record_uplink(
    signed: Record,
    actor: Who,
    seen: SeenVersion,
    proof: Annotated[PasswordProof, own_password(Record)],
    session: Writing,
) -> Uplink:
    """Record the next on-board state of a set by statement: SENT, LOADED, MISMATCH or UNKNOWN.

    `If-Match` is the ETag of the parameter set. VERIFIED comes only of `:read-back` of the set, which compares; ACTIVE only
    of a signed entry: `:activate`, or this with the password and the meaning of a person.
    """
    return _entry(session, actor, signed, proof, seen)


@router.get("/{uplink_id}", summary="Read a record", response_model=schemas.Uplink)
def get_uplink(uplink_id: Id, session: Reading) -> Uplink:
    """Read a record with its evidence."""
    return uplinks.get_uplink(session, uplink_id)


@router.get("/{uplink_id}/dump", summary="Download the dump", response_class=StoredFile)
def get_uplink_dump(uplink_id: Id, session: Reading, blobs: Blobs) -> StoredFile:
    """Download the bytes that a read-back compared, as they were uploaded."""
    sha256 = uplinks.dump_of(session, uplink_id)
    return StoredFile(blobs.path(sha256), filename=f"uplink-{uplink_id}-dump.bin", headers={"ETag": f'"{sha256}"'})
