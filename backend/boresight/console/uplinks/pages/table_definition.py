"""How a sensor's camera lies in the table on board: the definition as text, the bytes it makes, and every version there was."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.cameras import CAMERA_MODELS
from boresight.console.access.dependencies import Reading, ServerPolicy, Who, csrf
from boresight.console.approvals.tables import GateProfile
from boresight.console.change_proposals import service as proposals
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.pages.sensors import read_document, typed_document
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import RefusalContext, attempt, read_again, redirect, render
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.runs.pages.list import read_names
from boresight.console.uplinks import table_definitions
from boresight.console.uplinks.table_definitions import FilledTable
from boresight.console.uplinks.tables import TableDefinition
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, Policy
from boresight.platform.db.sessions import Session
from boresight.platform.web.paging import parse_row_id
from boresight.uplink.checksum import CHECKSUMS
from boresight.uplink.fields import Field
from boresight.uplink.table_definition import DecodedField, plain_definition

router = PageRouter(dependencies=[Depends(csrf)])

MAY_SET = frozenset({"analyst", "administrator"})
ENTRIES = (
    ("table_id", "Name of the table on board."),
    (
        "flight_software_version",
        "The flight software version with this layout; a package for another version is refused.",
    ),
    ("byte_order", "big or little; a field may have its own."),
    ("length_bytes, fill", "Size of the image, and the value of unused bytes."),
    (
        "fields",
        "name, offset_bytes or offset_bits, type (float32, float64, int<n>, uint<n>), and parameter or constant.",
    ),
    ("scale, offset", "For a field: number = scale × raw + offset. An integer with a scale is fixed-point."),
    ("crc", f"Optional: {', '.join(CHECKSUMS)}, or every parameter; offset_bytes where the table stores it."),
    ("cfe", "Optional: table_name and ids of cFE's file headers."),
    ("pus", "Optional: parameter_ids for TC[20,3]."),
)


@dataclass(frozen=True)
class LayoutLine:
    """A line of the layout."""

    name: str
    parameter: str
    byte: str
    kind: str
    raw: str
    value: str
    hexadecimal: str


@dataclass(frozen=True)
class TableDefinitionContext:
    """The state of the form after a refusal or a trial."""

    text: str = ""
    reason: str = ""
    refusal: RefusalContext | None = None
    tried: bool = False


def written_as_text(document: Mapping[str, Any]) -> str:
    """Write a definition for people, one line per field."""
    lines = [f'  "{key}": {json.dumps(value)}' for key, value in document.items() if key != "fields"]
    fields = ",\n".join(f"    {json.dumps(entry)}" for entry in document.get("fields", ()))
    at = list(document).index("fields") if "fields" in document else len(lines)
    lines.insert(at, f'  "fields": [\n{fields}\n  ]')
    return "{\n" + ",\n".join(lines) + "\n}\n"


def awaits_read_back(session: Session, sensor_id: int) -> bool:
    """Whether a sensor's baseline is on its way and not read back yet, so that nobody may be told which CRC to tell."""
    baseline = set_queries.find_baseline(session, sensor_id)
    return baseline is not None and baseline.onboard_state in {"SENT", "LOADED"}


def list_layout_lines(layout: FilledTable, *, with_crc: bool = True) -> Sequence[LayoutLine]:
    """Lay the fields out, a line each, the stored CRC among them unless it is not to be told."""
    fields = [_make_layout_line(one) for one in layout.decoded.fields]
    stored, crc = layout.definition.crc_field, layout.definition.crc
    if with_crc and stored is not None and crc is not None and layout.decoded.stored_crc is not None:
        value = layout.decoded.stored_crc
        text = layout.image[stored.bit // 8 : stored.end // 8].hex().upper()
        fields.append(LayoutLine("CRC", crc.name, f"{stored.bit // 8}", _kind(stored), "", str(value), text))
    return sorted(fields, key=lambda place: float(place.byte.replace(" bit ", ".")))


def _make_layout_line(one: DecodedField) -> LayoutLine:
    field = one.field
    byte = f"{field.bit // 8}" if field.bit % 8 == 0 else f"{field.bit // 8} bit {field.bit % 8}"
    raw = "" if field.plain else f"raw {one.raw:.9g}" if field.floating else f"raw {one.raw}"
    what = field.parameter or "constant"
    return LayoutLine(field.name, what, byte, _kind(field), raw, f"{one.value:.12g}", one.hexadecimal)


def _kind(field: Field) -> str:
    return f"{field.kind}, {'little' if field.little else 'big'}"


@router.get("/sensors/{sensor_id:int}/table-definition", response_class=HTMLResponse)
def table_definition_page(
    request: Request, session: Reading, actor: Who, policy: ServerPolicy, sensor_id: int, example: str = ""
) -> HTMLResponse:
    """Show the definition in force, or an example to begin with."""
    return _page(request, actor, policy, sensor_id, TableDefinitionContext(tried=bool(example)), session)


def _page(
    request: Request, actor: Actor, policy: Policy, sensor_id: int, shown: TableDefinitionContext, session: Session
) -> HTMLResponse:
    sensor = session.get_known(Sensor, sensor_id)
    versions = table_definitions.list_definitions(session, sensor_id)
    current = versions[0] if versions else None
    text = shown.text or written_as_text(
        current.document if current else plain_definition(sensor.document["camera_model"])
    )
    begun = bool(current or shown.text or shown.tried)
    hidden = awaits_read_back(session, sensor_id)
    layout, refusal = _laid_out(session, sensor_id, text) if begun and shown.refusal is None else (None, shown.refusal)
    return render(
        request,
        "uplinks/table_definition.html",
        refused=refusal,
        sensor=sensor,
        current=current,
        versions=versions,
        text=text if begun else "",
        layout=layout,
        in_force=bool(current and layout and layout.definition.document == current.document),
        places=[] if layout is None else list_layout_lines(layout, with_crc=not hidden),
        crc_hidden=hidden,
        refusal=refusal,
        names=read_names(session),
        pending=proposals.list_open_proposals(session, sensor_id, "table-definition"),
        confirmed=proposals.list_confirmed_by_number(session, sensor_id, "table-definition"),
        second_person=policy.second_person,
        entries=ENTRIES,
        parameters=CAMERA_MODELS[sensor.document["camera_model"]].parameter_names,
        may_set=bool(MAY_SET & actor.roles),
        shown=shown,
    )


def _laid_out(session: Session, sensor_id: int, text: str) -> tuple[FilledTable | None, RefusalContext | None]:
    """Lay out the baseline by the typed definition, or return why that is not possible."""
    try:
        return table_definitions.lay_out(session, sensor_id, read_document(text)), None
    except NotFoundError:
        raise
    except BoresightError as error:
        return None, RefusalContext.of(error)


@router.post("/sensors/{sensor_id:int}/table-definition", response_class=HTMLResponse)
async def change(request: Request, actor: Who, policy: ServerPolicy, sensor_id: int) -> Response:
    """Try a definition, or put it into force."""
    form = await request.form()
    reason = str(form.get("reason", ""))
    page = partial(_page, request, actor, policy, sensor_id)
    try:
        text = await typed_document(form)
    except RefusedInputError as error:
        return await read_again(request, partial(page, TableDefinitionContext("", reason, RefusalContext.of(error))))
    if form.get("action") != "set":
        return await read_again(request, partial(page, TableDefinitionContext(text, reason, tried=True)))
    seen = parse_row_id(str(form.get("number", "")))
    outcome = await attempt(request, partial(_set, actor, sensor_id, text, reason, seen, policy))
    if outcome.value is None:
        return await read_again(request, partial(page, TableDefinitionContext(text, reason, outcome.refusal)))
    if isinstance(outcome.value, ChangeProposal):
        flash = "Proposed: it takes effect when another person confirms it."
        return redirect(f"/change-proposals/{outcome.value.id}", flash=flash)
    flash = f"Version {outcome.value.number} is in force; open requests of the sensor are STALE."
    return redirect(f"/sensors/{sensor_id}/table-definition", flash=flash)


def _set(
    actor: Actor, sensor_id: int, text: str, reason: str, seen: int | None, policy: Policy, session: Session
) -> GateProfile | TableDefinition | ChangeProposal:
    if not text.strip():
        raise RefusedInputError("There is no table definition: type its JSON, or start with the example.")
    asked = ("table-definition", sensor_id, read_document(text), reason, seen)
    return proposals.change(session, actor, *asked, policy=policy)
