"""A set's way to the spacecraft: exported, sent, loaded, verified, active, each with its time, person and source.

What is shown is the present climb: what was recorded since the set was last sent. Everything recorded before stands in the
list below it. The page offers the steps that the state allows, and says why it offers no other.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import UploadFile

from boresight.api.dependencies import Who, csrf
from boresight.api.numbers import row_number
from boresight.errors import BoresightError
from boresight.pages.attempts import Refusal, attempt, proof_of_own
from boresight.pages.climb import Member, climb_of, exported_of, members_of, steps_of
from boresight.pages.forms import seen_version, texts_of
from boresight.pages.rendering import redirect, render
from boresight.pages.runs import read_names
from boresight.services import packages, parameter_sets, read_backs, sensors, timeline, uplinks
from boresight.services.actors import Actor
from boresight.services.passwords import PasswordProof
from boresight.store.blobs import BlobStore
from boresight.store.sessions import Session, reading
from boresight.store.tables import Package, ParameterSet, Uplink

router = APIRouter(dependencies=[Depends(csrf)])

NO_ROLE = (
    "Recording what is on board needs the role operator. An administrator can give it, on the page Users and keys."
)


@dataclass(frozen=True)
class Shown:
    """What a form left behind: which one, what was typed, and why it was refused."""

    form: str = ""
    typed: dict[str, str] = field(default_factory=dict)
    refusal: Refusal | None = None


@router.get("/parameter-sets/{set_id:int}/uplink", response_class=HTMLResponse)
def steps_page(request: Request, actor: Who, set_id: int) -> HTMLResponse:
    """Show a set's way to the spacecraft."""
    return _page(request, actor, set_id, Shown())


def _page(request: Request, actor: Actor, set_id: int, shown: Shown) -> HTMLResponse:
    """Render the page, with the refusal of a step and what was typed."""
    with reading(request.app.state.engine) as session:
        row = parameter_sets.get_parameter_set(session, set_id)
        records = uplinks.list_uplinks(session, parameter_set_id=set_id)
        built = packages.list_packages(session, parameter_set_id=set_id)
        exported = exported_of(built, records)
        names = read_names(session)
        reference, why = _reference(session, request.app.state.blobs, row)
        return render(
            request,
            "uplinks/uplink_steps.html",
            refused=shown.refusal,
            set=row,
            sensor=sensors.get_sensor(session, row.sensor_id),
            known=timeline.as_of(session, row.sensor_id),
            steps=steps_of(exported, records, names),
            records=records,
            compared=next((it for it in climb_of(records) if it.method), None) if records else None,
            packages=built,
            exported=exported,
            members=_members(session, request.app.state.blobs, exported),
            reference=reference,
            why_no_reference=why,
            next_states=uplinks.next_statements(session, row),
            why_not_sent=_why_not_sent(row),
            may_export=row.ground_state in packages.EXPORTED,
            readable=row.onboard_state in read_backs.READABLE,
            blocked=None if "operator" in actor.roles else NO_ROLE,
            names=names,
            shown=shown,
        )


def _why_not_sent(row: ParameterSet) -> str | None:
    """Say why a set cannot be sent."""
    if row.ground_state == "BASELINE" or row.onboard_state != "NOT SENT":
        return None
    return f"{row.name} is {row.ground_state}: only the baseline is sent. Have it approved and promote it."


def _members(session: Session, blobs: BlobStore, exported: Package | None) -> list[Member]:
    """List what a package holds; nothing where its bytes cannot be read."""
    if exported is None:
        return []
    try:
        return members_of(packages.read(session, blobs, exported.id))
    except BoresightError:
        return []


def _reference(session: Session, blobs: BlobStore, row: ParameterSet) -> tuple[read_backs.Reference | None, str | None]:
    """Return what a read-back would be held against, or why there is nothing."""
    try:
        return read_backs.reference_of(session, blobs, row), None
    except BoresightError as refusal:
        return None, str(refusal)


async def _form(request: Request) -> tuple[dict[str, str], bytes | None]:
    """Read the form's texts, and the dump if one was chosen."""
    form, dump = await request.form(), None
    file = form.get("file")
    if isinstance(file, UploadFile):
        dump = await file.read() if file.filename else None
        await file.close()
    return texts_of(form), dump


async def _taken_step(
    request: Request,
    actor: Actor,
    set_id: int,
    form: str,
    typed: dict[str, str],
    change: Callable[..., Any],
    said: str,
    prepare: Callable[[], Awaitable[Sequence[object]]] | None = None,
) -> Response:
    """Take a step and show where the set is now, or show why it was refused with what was typed."""
    outcome = await attempt(request, change, prepare)
    if outcome.value is None:
        kept = {name: value for name, value in typed.items() if name != "password"}
        return await run_in_threadpool(partial(_page, request, actor, set_id, Shown(form, kept, outcome.refusal)))
    matched = getattr(outcome.value, "onboard_state", "") != "MISMATCH"  # the page itself says of a mismatch what it is
    return redirect(f"/parameter-sets/{set_id}/uplink", flash=said if matched else "")


@router.post("/parameter-sets/{set_id:int}/uplink/package")
async def export(request: Request, actor: Who, set_id: int) -> Response:
    """Build the set's package, or show the one that exists."""
    typed, _ = await _form(request)
    state = request.app.state

    def change(session: Session) -> Package:
        return packages.build(session, actor, state.blobs, set_id, policy=state.policy)

    return await _taken_step(
        request, actor, set_id, "package", typed, change, "The package is built; download it below."
    )


@router.post("/parameter-sets/{set_id:int}/uplink/record")
async def record(request: Request, actor: Who, set_id: int) -> Response:
    """Record the next state by statement."""
    typed, _ = await _form(request)
    package = typed.get("package_id", "")

    def change(session: Session) -> Uplink:
        state, source = typed.get("onboard_state", ""), typed.get("source", "")
        package_id = row_number(package)
        happened = typed.get("happened_utc")
        return uplinks.record(
            session, actor, set_id, state, source, seen_version(typed), package_id=package_id, happened=happened
        )

    return await _taken_step(request, actor, set_id, "record", typed, change, "Recorded.")


@router.post("/parameter-sets/{set_id:int}/uplink/read-back")
async def read_back(request: Request, actor: Who, set_id: int) -> Response:
    """Hold a dump or a CRC against what was sent."""
    typed, dump = await _form(request)

    def change(session: Session) -> Uplink:
        read = read_backs.dump_or_crc(dump, typed.get("crc", ""))
        blobs, source = request.app.state.blobs, typed.get("source", "")
        return read_backs.read_back(
            session, actor, blobs, set_id, read, source, seen_version(typed), typed.get("happened_utc")
        )

    by = "by CRC" if dump is None else "byte for byte"
    return await _taken_step(request, actor, set_id, "read-back", typed, change, f"What was read back matches, {by}.")


@router.post("/parameter-sets/{set_id:int}/uplink/activate")
async def activate(request: Request, actor: Who, set_id: int) -> Response:
    """Sign that the set is active."""
    typed, _ = await _form(request)

    def change(session: Session, proof: PasswordProof) -> Uplink:
        source, meaning, seen = typed.get("source", ""), typed.get("meaning", ""), seen_version(typed)
        happened = typed.get("happened_utc")
        return uplinks.activate(session, actor, set_id, source, meaning, proof, seen, happened=happened)

    prove = proof_of_own(request, actor, typed.get("password", ""))
    said = "Signed: the set is ACTIVE on board."
    return await _taken_step(request, actor, set_id, "activate", typed, change, said, prove)
