"""Ground and board of all sensors, and a set's way to the spacecraft: exported, sent, loaded, verified, active.

Ground and board are two facts and never one word. Shown is what was recorded since the set was last sent; everything
before stands in the list below.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response
from starlette.datastructures import UploadFile

from boresight.console import list_queries as lists
from boresight.console.access.dependencies import (
    Blobs,
    Database,
    OwnKey,
    Reading,
    ServerPolicy,
    Who,
    csrf,
    get_needed,
    get_server,
)
from boresight.console.access.passwords import PasswordProof
from boresight.console.approvals.review import warn_of_turn
from boresight.console.fleet import timeline
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.timeline import AsOf, describe_source
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    attempt,
    get_texts,
    proof_of_own,
    read_again,
    redirect,
    render,
    seen_version,
)
from boresight.console.pages.tables import Table, TableColumn, accept_one, is_text, read_page, read_view
from boresight.console.parameter_sets.pages import read_set_and_incumbent
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.pages.list import read_names
from boresight.console.uplinks import hand_over as hand_overs
from boresight.console.uplinks import packages, read_backs
from boresight.console.uplinks import service as uplinks
from boresight.console.uplinks.hand_over import HandOver
from boresight.console.uplinks.queries import BOARD_WORDS, find_baseline_before, find_c_sd_record
from boresight.console.uplinks.stations import find_exported_package, find_uplink_progress, make_workflow
from boresight.console.uplinks.tables import Package, Uplink
from boresight.errors import BoresightError, RefusedInputError
from boresight.figures.tables import set_rows
from boresight.mission_control.systems import Link
from boresight.platform.actors import Actor
from boresight.platform.blobs import files
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, open_reading
from boresight.platform.web.paging import parse_row_id

board_router = PageRouter()

BOARDS = Table(
    "sensors",
    "Sensors, those that need attention first",
    (
        TableColumn("sensor", "Sensor", "sensor", "nowrap", head=True),
        TableColumn("status", "Status", "board", "tight"),
        TableColumn("baseline", "Baseline on the ground", "baseline"),
        TableColumn("board", "On board"),
        TableColumn("source", "Source", "", "said"),
        TableColumn("recorded", "Recorded", "", "tight"),
        TableColumn("next", "Next", "", "tight"),
    ),
    {"q": is_text, "status": accept_one(BOARD_WORDS)},
    "board",
    kind="events",
    path="/uplink",
)


@dataclass(frozen=True)
class UplinkLine:
    """One sensor: what is said of it, how bad that is, and the newest record."""

    known: AsOf
    level: str
    word: str
    shown: tuple[ParameterSet, Uplink] | None
    how: str


def make_uplink_line(known: AsOf) -> UplinkLine:
    """Lay out a sensor's ground and on-board state."""
    by_state = {record.onboard_state: (row, record) for row, record in known.on_board}
    newest = known.on_board[-1] if known.on_board else None
    shown = by_state.get("MISMATCH") or known.active or newest
    baseline_id = None if known.baseline is None else known.baseline.id
    level, word = find_worst_known(baseline_id, [(row.id, record.onboard_state) for row, record in known.on_board])
    return UplinkLine(known, level, word, shown, "" if shown is None else describe_source(shown[1]))


def find_worst_known(baseline_id: int | None, on_board: Sequence[tuple[int, str]]) -> tuple[str, str]:
    """Return the worst of what is known, as a level and a word."""
    said = {state for _, state in on_board}
    active = next((set_id for set_id, state in on_board if state == "ACTIVE"), None)
    if active is not None:
        said.add("THE SAME" if active == baseline_id else "DIFFERS")
    word = next((one for one in BOARD_WORDS if one in said), "NOT SENT")
    return BOARD_WORDS[word], word


@board_router.get("/uplink", response_class=HTMLResponse)
def uplink_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """Show a page of the fleet on the ground and on board."""
    view = read_view(request, BOARDS)
    where = {name: view.where[asked] for name, asked in (("q", "q"), ("board", "status")) if asked in view.where}
    found = read_page(session, view, status=None, **where)
    return render(
        request,
        "uplinks/uplink.html",
        view=view,
        lines=[make_uplink_line(timeline.get_state_at(session, sensor.id)) for sensor in found.rows],
        last=found.last,
        words=BOARD_WORDS,
        found=lists.count(session, "sensors", where),
        names=read_names(session),
        actor=actor,
    )


@dataclass(frozen=True)
class PackageMember:
    """A file inside a package."""

    name: str
    size_bytes: int
    sha256: str


def list_package_members(content: bytes) -> list[PackageMember]:
    """List the files of a package with their hashes."""
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return [
            PackageMember(name, len(inside), hashlib.sha256(inside).hexdigest())
            for name in packed.namelist()
            for inside in (packed.read(name),)
        ]


router = PageRouter(dependencies=[Depends(csrf)])

NO_ROLE = "Recording what is on board needs the role operator. An administrator can give it to you on the page Users and keys."


@dataclass(frozen=True)
class UplinkStepsContext:
    """The state of a refused form: which one, what was typed, and why it was refused."""

    form: str = ""
    typed: dict[str, str] = field(default_factory=dict)
    refusal: RefusalContext | None = None


@router.get("/parameter-sets/{set_id:int}/uplink", response_class=HTMLResponse)
def steps_page(request: Request, session: Reading, actor: Who, blobs: Blobs, set_id: int) -> HTMLResponse:
    """Show a set's way to the spacecraft."""
    return _page(request, actor, blobs, set_id, UplinkStepsContext(), session)


def _page(
    request: Request, actor: Actor, blobs: BlobStore, set_id: int, shown: UplinkStepsContext, session: Session
) -> HTMLResponse:
    row = session.get_known(ParameterSet, set_id)
    records = lists.list_newest(session, Uplink, set=set_id)
    built = lists.list_newest(session, Package, set=set_id)
    exported = find_exported_package(built, records)
    names = read_names(session)
    workflow = make_workflow(session, actor, get_server(request).policy, row)
    reference, why = _reference(session, blobs, row)
    known, sensor = timeline.get_state_at(session, row.sensor_id), session.get_known(Sensor, row.sensor_id)
    other = known.active[0] if known.active and known.active[0].id != row.id else None
    old = other or find_baseline_before(session, row)
    document, before = read_set_and_incumbent(row, old)
    is_open = uplinks.is_c_sd_open(session, row)
    return render(
        request,
        "uplinks/uplink_steps.html",
        refused=shown.refusal,
        set=row,
        sensor=sensor,
        known=known,
        old=old,
        active_other=other is not None,
        rows=set_rows(document, before, sensor.document["typical_sigma"]),
        turn=warn_of_turn(document).get("attitude-turn"),
        workflow=workflow,
        steps=workflow.stations[5:],
        records=records,
        compared=next((it for it in find_uplink_progress(records) if it.method), None) if records else None,
        packages=built,
        exported=exported,
        members=_members(session, blobs, exported),
        reference=reference,
        why_no_reference=why,
        next_states=uplinks.list_next_statements(session, row),
        sendable={one.id for one in uplinks.list_sendable_packages(session, row, built)},
        c_sd=find_c_sd_record(session, row),
        why_c_sd=uplinks.explain_c_sd(session, row),
        may_record_c_sd=row.onboard_state in uplinks.WITH_C_SD,
        c_sd_open=is_open and row.onboard_state in uplinks.WITH_C_SD,
        loading_asks=is_open,
        crc_held=uplinks.has_shown_mismatch(session, row),
        why_not_active=uplinks.explain_why_not_activate(session, actor, row),
        why_not_sent=_why_not_sent(row),
        stores=[link for link in _links(request).values() if link.store and row.ground_state == "BASELINE"],
        handed_over=hand_overs.list_hand_overs(session, [one.id for one in built]),
        may_export=row.ground_state in packages.EXPORTED,
        why_not_export=packages.explain_why_not_export(session, row),
        readable=row.onboard_state in read_backs.READABLE,
        blocked=None if "operator" in actor.roles else NO_ROLE,
        names=names,
        needed=get_needed(request, session, actor),
        shown=shown,
    )


def _links(request: Request) -> Mapping[str, Link]:
    links: Mapping[str, Link] = request.app.state.mission_control.links
    return links


def _why_not_sent(row: ParameterSet) -> str | None:
    if row.ground_state == "BASELINE" or row.onboard_state != "NOT SENT":
        return None
    return f"{row.name} is {row.ground_state}: only the baseline is sent. Have it approved and promote it."


def _members(session: Session, blobs: BlobStore, exported: Package | None) -> list[PackageMember]:
    if exported is None:
        return []
    try:
        return list_package_members(packages.read(session, blobs, exported.id))
    except BoresightError:
        return []


def _reference(session: Session, blobs: BlobStore, row: ParameterSet) -> tuple[read_backs.SentTable | None, str | None]:
    """Return the reference of a read-back, or why there is none."""
    try:
        return read_backs.get_sent_table(session, blobs, row), None
    except BoresightError as refusal:
        return None, str(refusal)


async def _form(request: Request) -> tuple[dict[str, str], bytes | None]:
    form, dump = await request.form(), None
    file = form.get("file")
    if isinstance(file, UploadFile):
        dump = await file.read() if file.filename else None
        await file.close()
    return get_texts(form), dump


async def _taken_step(
    request: Request,
    actor: Actor,
    blobs: BlobStore,
    form: str,
    typed: dict[str, str],
    change: Callable[..., Any],
    said: str,
    prepare: Callable[[], Awaitable[Sequence[object]]] | None = None,
) -> Response:
    """Record a step and redirect to the page, or show why it was refused with what was typed."""
    set_id = request.path_params["set_id"]
    outcome = await attempt(request, change, prepare)
    if outcome.value is None:
        kept = {name: value for name, value in typed.items() if name != "password"}
        shown = UplinkStepsContext(form, kept, outcome.refusal)
        return await read_again(request, partial(_page, request, actor, blobs, set_id, shown))
    matched = getattr(outcome.value, "onboard_state", "") != "MISMATCH"  # the page itself explains a mismatch
    return redirect(f"/parameter-sets/{set_id}/uplink", flash=said if matched else "", code=form if matched else "")


@router.post("/parameter-sets/{set_id:int}/uplink/package")
async def export(
    request: Request, actor: Who, blobs: Blobs, policy: ServerPolicy, key: OwnKey, set_id: int
) -> Response:
    """Build the set's package, or show the one that exists."""
    typed, _ = await _form(request)

    def make() -> packages.Prepared | None:
        with open_reading(request.app.state.engine) as session:
            return packages.prepare(session, actor, blobs, set_id, policy=policy, key=key)

    async def prepare() -> tuple[packages.Prepared | None]:
        return (await run_in_threadpool(make),)

    def change(session: Session, prepared: packages.Prepared | None) -> Package:
        return packages.build(session, actor, blobs, set_id, prepared, policy=policy)

    said = "The package is built and downloads now; it can be downloaded again below."
    return await _taken_step(request, actor, blobs, "package", typed, change, said, prepare)


@router.post("/parameter-sets/{set_id:int}/uplink/hand-over")
async def hand_over(request: Request, actor: Who, blobs: Blobs, set_id: int) -> Response:
    """Hand the table of the set's package over to a mission control system."""
    typed, _ = await _form(request)

    def begin(session: Session) -> HandOver:
        system, seen = typed.get("system", ""), seen_version(typed)
        return hand_overs.begin(session, actor, blobs, _links(request), set_id, system, seen)

    begun = await attempt(request, begin)
    if begun.value is None:
        shown = UplinkStepsContext("hand-over", typed, begun.refusal)
        return await read_again(request, partial(_page, request, actor, blobs, set_id, shown))
    going = begun.value

    async def send() -> tuple[Sequence[str]]:
        return (await run_in_threadpool(going.send),)

    def end(session: Session, places: Sequence[str]) -> HandOver:
        hand_overs.end(session, actor, going, places)
        return going

    said = f"Handed over to {going.link.title}. Nothing was commanded; record that it was sent once it is."
    return await _taken_step(request, actor, blobs, "hand-over", typed, end, said, send)


@router.post("/parameter-sets/{set_id:int}/uplink/record")
async def record(request: Request, actor: Who, blobs: Blobs, set_id: int) -> Response:
    """Record the next state by statement."""
    typed, _ = await _form(request)
    package = typed.get("package_id", "")

    def change(session: Session) -> Uplink:
        state, source = typed.get("onboard_state", ""), typed.get("source", "")
        package_id = parse_row_id(package)
        happened = typed.get("happened_utc")
        if (
            state == "LOADED"
            and not typed.get("c_sd")
            and uplinks.is_c_sd_open(session, session.get_known(ParameterSet, set_id))
        ):
            raise RefusedInputError(
                "Say whether the update of C_SD was loaded with the set: choose one of the answers."
            )
        c_sd = uplinks.CsdAnswer.from_given(typed.get("c_sd"), typed.get("c_sd_said", ""))
        seen = seen_version(typed)
        return uplinks.record(
            session, actor, set_id, state, source, seen, package_id=package_id, happened=happened, c_sd=c_sd
        )

    said = f"Recorded: the set is {typed.get('onboard_state', '')}."
    if typed.get("c_sd"):
        said += f" Its update of C_SD: {typed['c_sd']}."
    return await _taken_step(request, actor, blobs, "record", typed, change, said)


@router.post("/parameter-sets/{set_id:int}/uplink/read-back")
async def read_back(request: Request, actor: Who, blobs: Blobs, engine: Database, set_id: int) -> Response:
    """Hold a dump or a CRC against what was sent."""
    typed, dump = await _form(request)

    def change(session: Session) -> Uplink:
        read = read_backs.choose_dump_or_crc(dump, typed.get("crc", ""))
        source, happened = typed.get("source", ""), typed.get("happened_utc")
        return read_backs.read_back(session, actor, blobs, set_id, read, source, seen_version(typed), happened)

    async def keep() -> tuple[()]:
        await run_in_threadpool(
            kept.enter_context, files.stored_ahead(engine, blobs, *read_backs.list_to_store(actor, dump))
        )
        return ()

    by = "by CRC" if dump is None else "byte for byte"
    kept = ExitStack()
    try:
        return await _taken_step(
            request, actor, blobs, "read-back", typed, change, f"The read-back matches, {by}.", keep
        )
    finally:
        await run_in_threadpool(kept.close)


@router.post("/parameter-sets/{set_id:int}/uplink/activate")
async def activate(request: Request, actor: Who, blobs: Blobs, set_id: int) -> Response:
    """Sign that the set is active."""
    typed, _ = await _form(request)

    def change(session: Session, proof: PasswordProof) -> Uplink:
        source, meaning, seen = typed.get("source", ""), typed.get("meaning", ""), seen_version(typed)
        happened = typed.get("happened_utc")
        return uplinks.activate(session, actor, set_id, source, meaning, proof, seen, happened=happened)

    prove = proof_of_own(request, actor, typed)
    said = "Signed: the set is ACTIVE on board."
    return await _taken_step(request, actor, blobs, "activate", typed, change, said, prove)
