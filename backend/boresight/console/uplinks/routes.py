"""Operations on sets on board, uplink packages and table definitions."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import Depends
from fastapi.concurrency import contextmanager_in_threadpool, run_in_threadpool
from pydantic import Field, SecretStr
from starlette.datastructures import UploadFile
from starlette.requests import Request

from boresight.console import list_queries as lists
from boresight.console import schemas as console_schemas
from boresight.console.access.dependencies import (
    Blobs,
    Database,
    IsDryRun,
    OwnKey,
    Reading,
    SeenVersion,
    ServerPolicy,
    Who,
    Writing,
    factor_field,
    open_write_or_dry_run,
    own_password,
    password_field,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals.tables import GateProfile
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.routes import PROPOSED, in_force_or_proposed
from boresight.console.operation import FORM_CONTENT, Idempotency, OperationResponse, get_idempotency, operations
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.schemas import Shape, file_field, multipart
from boresight.console.uplinks import hand_over as hand_overs
from boresight.console.uplinks import packages, read_backs, schemas, table_definitions
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.hand_over import HandOver
from boresight.console.uplinks.stations import Workflow, make_workflow
from boresight.console.uplinks.tables import Package, TableDefinition, Uplink
from boresight.errors import RefusedInputError
from boresight.platform.actors import Actor
from boresight.platform.blobs import files
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.media import StoredFile, ZipFile
from boresight.platform.web.openapi import refuses
from boresight.platform.web.paging import Id, Listing, Page, Paged
from boresight.platform.web.text_validation import LONGEST_TEXT

router = operations("/uplinks", tags=["uplinks"])


class Record(Shape):
    """An on-board state to record, and its source."""

    parameter_set_id: Id
    onboard_state: str = Field(examples=["SENT"])
    source: str = Field(
        max_length=LONGEST_TEXT,
        description="The pass, the procedure or the read-back file.",
        examples=["Pass 4711, TC log line 88"],
    )
    package_id: Id | None = Field(None, description="The uplink package that was sent, where one was built.")
    happened_utc: str | None = Field(None, description="When it happened, if earlier than now.")
    c_sd: Literal["LOADED", "NOT YET", "NOT NEEDED"] | None = Field(
        None,
        description="Of a set whose loading turns the attitude: whether its update of C_SD was loaded. Given with LOADED, or "
        "later with the state that the set is in, which then stays; left out, it is not told.",
    )
    c_sd_said: str = Field(
        "",
        max_length=LONGEST_TEXT,
        description="When and how the update was loaded, or why it is not needed; with `c_sd`.",
    )
    meaning: str | None = Field(None, max_length=LONGEST_TEXT, description="For ACTIVE: what the signature means.")
    password: SecretStr | None = Field(None, description="For ACTIVE: your password again, because a person signs.")
    factor: SecretStr = factor_field()

    @property
    def signed(self) -> bool:
        """Whether the body has any part of a signature."""
        return self.password is not None or self.meaning is not None


def _entry(session: Session, actor: Actor, record: Record, proof: PasswordProof, seen: int | None) -> Uplink:
    """Record the entry: with a signature as `:activate` does, otherwise by statement."""
    set_id, happened = record.parameter_set_id, record.happened_utc
    c_sd = uplinks.CsdAnswer.from_given(record.c_sd, record.c_sd_said)
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
            c_sd=c_sd,
        )
    if record.onboard_state != "ACTIVE" or record.package_id is not None or c_sd is not None:
        raise RefusedInputError(
            "Only ACTIVE is signed, and its package and C_SD are recorded by themselves; leave out password and meaning, or those."
        )
    return uplinks.activate(session, actor, set_id, record.source, record.meaning or "", proof, seen, happened=happened)


@router.get("", summary="List records", response_model=Page[schemas.Uplink])
def list_uplinks(
    session: Reading, page: Paged, parameter_set_id: Id | None = None, sensor_id: Id | None = None
) -> Listing[Uplink]:
    """List what was recorded, newest first."""
    return page.cut(lists.list_newest(session, Uplink, **page.rows, set=parameter_set_id, sensor=sensor_id))


@router.post("", summary="Record a step on board", status_code=201, response_model=schemas.Uplink)
def record_uplink(
    signed: Record,
    actor: Who,
    seen: SeenVersion,
    proof: Annotated[PasswordProof, own_password(Record)],
    session: Writing,
) -> Uplink:
    """Record the next on-board state of a set by statement, SENT, LOADED, MISMATCH or UNKNOWN; or its update of C_SD.

    `If-Match` is the ETag of the parameter set. VERIFIED comes only from `:read-back` of the set, which compares; ACTIVE only
    from a signed entry: `:activate`, or this with a person's password and meaning.
    """
    return _entry(session, actor, signed, proof, seen)


@router.get("/{uplink_id}", summary="Read a record", response_model=schemas.Uplink)
def get_uplink(uplink_id: Id, session: Reading) -> Uplink:
    """Read a record with its evidence."""
    return session.get_known(Uplink, uplink_id)


@router.get("/{uplink_id}/dump", summary="Download the dump", response_class=StoredFile)
def get_uplink_dump(uplink_id: Id, session: Reading, blobs: Blobs) -> StoredFile:
    """Download the bytes that a read-back compared, as they were uploaded."""
    sha256 = uplinks.get_dump_digest(session, uplink_id)
    return StoredFile(blobs.path(sha256), filename=f"uplink-{uplink_id}-dump.bin", headers={"ETag": f'"{sha256}"'})


onboard_router = operations("/parameter-sets", tags=["uplinks"])

MOST_FIELDS = 10
FORM = multipart(
    ("source",),
    source={"type": "string", "maxLength": LONGEST_TEXT, "description": "The pass, the procedure or the packet."},
    file=file_field("The dump of the table."),
    crc={"type": "string", "description": "Or the CRC that was reported, in hexadecimal."},
    happened_utc={"type": "string", "description": "When it was read, if earlier than now."},
)


@dataclass(frozen=True)
class ReadBack:
    """The body of a read-back: its fields, and the dump if there was one."""

    source: str
    crc: str
    happened: str
    dump: bytes | None

    def content(self) -> bytes:
        """Return the content for the digest of the request; the raw form differs each time it is sent."""
        return repr((self.source, self.crc, self.happened)).encode() + hashlib.sha256(self.dump or b"").digest()


async def read_form(
    request: Request,
) -> ReadBack:
    """Read the form; a missing field counts as empty."""
    async with request.form(max_files=1, max_fields=MOST_FIELDS) as form:
        file = form.get("file")
        dump = await file.read() if isinstance(file, UploadFile) and file.filename else None
        texts = {name: value for name, value in form.items() if isinstance(value, str)}
    came = ReadBack(texts.get("source", ""), texts.get("crc", ""), texts.get("happened_utc", ""), dump)
    setattr(request.state, FORM_CONTENT, came.content)
    return came


async def stored_read_back(
    actor: Who,
    came: Annotated[ReadBack, Depends(read_form)],
    engine: Database,
    blobs: Blobs,
    is_dry_run: IsDryRun,
) -> AsyncIterator[ReadBack]:
    """Store the dump before the transaction begins."""
    contents = read_backs.list_to_store(actor, None if is_dry_run else came.dump)
    async with contextmanager_in_threadpool(files.stored_ahead(engine, blobs, *contents)):
        yield came


@onboard_router.get("/{parameter_set_id}/workflow", summary="Read where a set stands", response_model=schemas.Workflow)
def get_workflow(session: Reading, actor: Who, policy: ServerPolicy, parameter_set_id: Id) -> Workflow:
    """Return the ten stations of a set, and who is to do what next."""
    return make_workflow(session, actor, policy, session.get_known(ParameterSet, parameter_set_id))


@onboard_router.post(
    "/{parameter_set_id}:read-back",
    summary="Compare a dump or a CRC",
    status_code=201,
    response_model=schemas.Uplink,
    openapi_extra=FORM,
)
def read_back(
    parameter_set_id: Id,
    actor: Who,
    seen: SeenVersion,
    came: Annotated[ReadBack, Depends(stored_read_back, scope="function")],
    session: Writing,
    blobs: Blobs,
) -> Uplink:
    """Compare the dump of the table, or the CRC that the spacecraft reported, with what was sent.

    Records VERIFIED (`method` says by what), or MISMATCH with the differing bytes and fields in `evidence`.
    """
    read = read_backs.choose_dump_or_crc(came.dump, came.crc)
    return read_backs.read_back(session, actor, blobs, parameter_set_id, read, came.source, seen, came.happened)


class Activation(Shape):
    """The signed entry that a set is what the sensor runs with."""

    source: str = Field(
        max_length=LONGEST_TEXT, description="Source of the statement.", examples=["TM page STR-2, pass 4711"]
    )
    meaning: str = Field(
        max_length=LONGEST_TEXT,
        description="What the signature means.",
        examples=["I saw this table active in telemetry."],
    )
    password: SecretStr = password_field("Your password again: the person signs, not the log-in.")
    factor: SecretStr = factor_field()
    happened_utc: str | None = Field(None, description="When it became active, if earlier than now.")


@onboard_router.post(
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


class Destination(Shape):
    """Where a table is handed over to."""

    system: str = Field(description="`yamcs` or `openc3`, where its store is set.", examples=["yamcs"], max_length=20)


async def handed_over(
    request: Request,
    parameter_set_id: Id,
    to: Destination,
    actor: Who,
    seen: SeenVersion,
    blobs: Blobs,
    is_dry_run: IsDryRun,
    idempotency: Annotated[Idempotency, Depends(get_idempotency)],
) -> tuple[HandOver, Sequence[str]] | None:
    """Put the beginning on record and send the table, before the transaction of its end; nothing where the answer is known."""
    engine, links = request.app.state.engine, request.app.state.mission_control.links

    def begin(session: Session) -> HandOver:
        return hand_overs.begin(session, actor, blobs, links, parameter_set_id, to.system, seen)

    if await run_in_threadpool(idempotency.is_answered, engine):
        return None
    async with asynccontextmanager(open_write_or_dry_run)(request, is_dry_run) as session:
        going = await run_in_threadpool(begin, session)
    return going, () if is_dry_run else await run_in_threadpool(going.send)


@onboard_router.post(
    "/{parameter_set_id}:hand-over", summary="Hand its table over to mission control", response_model=schemas.HandOver
)
def hand_over_parameter_set(
    actor: Who, done: Annotated[tuple[HandOver, Sequence[str]], Depends(handed_over)], session: Writing
) -> schemas.HandOver:
    """Store the table of the baseline's newest package in Yamcs or OpenC3, for whoever commands there.

    An operator does it in person, and it is on record before and after. Nothing is commanded, and the set's state on board stays
    as it is recorded; the same table again is the same object.
    """
    handed, places = done
    hand_overs.end(session, actor, handed, places)
    return schemas.HandOver(
        package_id=handed.package_id, package_sha256=handed.sha256, to=handed.link.place, places=list(places)
    )


package_router = operations(tags=["uplinks"])


class Export(Shape):
    """What the spacecraft has; said, the package is refused for anything else."""

    flight_software_version: str | None = Field(None, examples=["4.2.1"])
    table_id: str | None = Field(None, examples=["STR_CAM"])


def prepared_package(
    actor: Who,
    parameter_set_id: Id,
    policy: ServerPolicy,
    engine: Database,
    blobs: Blobs,
    key: OwnKey,
    idempotency: Annotated[Idempotency, Depends(get_idempotency)],
) -> packages.Prepared | None:
    """Make the package before the transaction that stores it; nothing where the answer is known."""
    if idempotency.is_answered(engine):
        return None
    with open_reading(engine) as session:
        return packages.prepare(session, actor, blobs, parameter_set_id, policy=policy, key=key)


@package_router.post(
    "/parameter-sets/{parameter_set_id}:export",
    summary="Build the uplink package",
    status_code=201,
    response_model=schemas.Package,
)
@refuses(412)
def export_parameter_set(
    parameter_set_id: Id,
    actor: Who,
    policy: ServerPolicy,
    prepared: Annotated[packages.Prepared | None, Depends(prepared_package)],
    session: Writing,
    blobs: Blobs,
    export: Export | None = None,
) -> Package:
    """Build the signed package for an approved set or the baseline; the same inputs give the existing one."""
    said = {} if export is None else export.model_dump()
    return packages.build(session, actor, blobs, parameter_set_id, prepared, policy=policy, **said)


@package_router.get("/packages", summary="List packages", response_model=Page[schemas.Package])
def list_packages(
    session: Reading, page: Paged, parameter_set_id: Id | None = None, sensor_id: Id | None = None
) -> Listing[Package]:
    """List the packages that were built, newest first."""
    return page.cut(lists.list_newest(session, Package, **page.rows, set=parameter_set_id, sensor=sensor_id))


@package_router.get("/packages/{package_id}", summary="Read a package's entry", response_model=schemas.Package)
def get_package(package_id: Id, session: Reading) -> Package:
    """Read the entry of a package: its set and purpose; `/content` is the file."""
    return session.get_known(Package, package_id)


@package_router.get("/packages/{package_id}/content", summary="Read a package", response_class=ZipFile)
def get_package_content(package_id: Id, session: Reading, blobs: Blobs) -> ZipFile:
    """Read the ZIP, its bytes checked against their hash."""
    row = session.get_known(Package, package_id)
    headers = {
        "Content-Disposition": f'attachment; filename="{packages.make_file_name(session, row)}"',
        "ETag": f'"{row.sha256}"',
    }
    return ZipFile(packages.read(session, blobs, package_id), headers=headers)


table_definition_router = operations("/sensors", tags=["uplinks"])

EXAMPLE = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "byte_order": "big",
    "length_bytes": 28,
    "fields": [{"name": "FOCAL_LENGTH", "parameter": "f_m", "offset_bytes": 0, "type": "float32"}],
    "crc": {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 26},
}


class NewTableDefinition(Shape):
    """A definition to put into force, and why."""

    document: console_schemas.Document = Field(
        description="Every parameter of the camera model needs one field.", examples=[EXAMPLE]
    )
    reason: str = Field(examples=["Flight software 4.2.1 stores the focal length in millimetres."])


@table_definition_router.get(
    "/{sensor_id}/table-definitions",
    summary="List the table definitions of a sensor",
    response_model=Page[schemas.TableDefinition],
)
def list_table_definitions(sensor_id: Id, session: Reading, page: Paged) -> OperationResponse:
    """List every version, newest first; the first is in force, and the ETag is needed to set another, `"v0"` for none."""
    found = table_definitions.list_definitions(session, sensor_id)
    tag = schemas.TableDefinition.etag(found[0]) if found else '"v0"'
    return OperationResponse(page.cut_whole(found), headers={"ETag": tag})


@table_definition_router.post(
    "/{sensor_id}/table-definitions",
    summary="Set the table definition of a sensor",
    status_code=201,
    response_model=schemas.TableDefinition,
    responses=PROPOSED,
)
def set_table_definition(
    sensor_id: Id,
    definition: NewTableDefinition,
    actor: Who,
    seen: SeenVersion,
    policy: ServerPolicy,
    session: Writing,
) -> GateProfile | TableDefinition | OperationResponse:
    """Put another layout into force. The sensor's open requests become STALE, because their bytes would change.

    Where the setting `second_person` is on, the change is proposed, answered with 202, and changes nothing until another
    analyst or administrator confirms it.
    """
    made = proposals.change(
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
