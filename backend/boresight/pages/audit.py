"""The audit log: who did what to what, with what changed, and whether the chain of hashes holds.

The address holds the view: `?object=parameter-sets/3&actor=Ana+Lima&action=promoted&since=2026-11-01&before=812`. A
short chain is verified at every visit; of a long one the page shows what the server's own walk found last, and verifies
it when asked (`?verify=1`), for every record and every sealed row must be read.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, Who
from boresight.errors import RefusedInputError
from boresight.pages.audit_changes import Change, changes
from boresight.pages.rendering import render
from boresight.pages.tables import Column, Page, Table, View, all_of, csv_of, is_text, page_of, read_view
from boresight.services import audit
from boresight.store.files import total_bytes
from boresight.store.tables import AuditRecord

FILTERS = ("object", "actor", "action", "since", "until")
RECORDS = Table(
    "audit",
    "Records",
    (
        Column("number", "No.", "-number", "num", head=True),
        Column("time", "Time", "", "tight"),
        Column("who", "Who, with what", "who", "named"),
        Column("did", "Did, to", "did", "happening"),
        Column("changed", "What changed", "", "words"),
        Column("reason", "Reason", "", "words"),
        Column("hash", "Hash, request", "", "tight"),
    ),
    dict.fromkeys(FILTERS, is_text),
    "-number",
    kind="audit",
)
CSV_FIELDS = {
    "number": ("id",),
    "time": ("at_utc",),
    "who": ("actor", "credential", "roles"),
    "did": ("action", "object"),
    "changed": ("changed",),
    "reason": ("reason",),
    "hash": ("hash", "request_id"),
}
VERIFIED_AT_EVERY_VISIT = 1000
READ_AT_EVERY_VISIT = 100_000_000  # bytes of stored files
IN_GIST = 3
TELLING = (
    "name",
    "label",
    "sensor",
    "set",
    "state",
    "ground_state",
    "onboard_state",
    "method",
    "purpose",
    "decision",
    "roles",
)
PAGE_OF_NOUN = {
    "sensors": "sensors",
    "telemetry-sets": "telemetry",
    "runs": "runs",
    "parameter-sets": "parameter-sets",
    "approvals": "approvals",
    "alarms": "alarms",
}

router = APIRouter()


@dataclass(frozen=True)
class Line:
    """One record as the page lays it out."""

    record: AuditRecord
    address: str | None
    changes: list[Change]

    @property
    def gist(self) -> str:
        """What matters of the change, in one short line."""
        telling = [it for it in self.changes if it.name.rpartition(".")[2] in TELLING] or self.changes
        return " · ".join(f"{it.before} → {it.after}" if it.before != "–" else it.after for it in telling[:IN_GIST])


def _sought(view: View) -> dict[str, Any]:
    """Say what a view is narrowed to, as the list takes it.

    Raises
    ------
    RefusedInputError
        When a time cannot be read.
    """
    return {"since": None, "until": None} | asdict(audit.sought(**{name: view.where.get(name) for name in FILTERS}))


def line_of(record: AuditRecord) -> Line:
    """Lay out a record; its object links to its page where it has one."""
    noun, _, rest = record.object.partition("/")
    page = PAGE_OF_NOUN.get(noun)
    address = f"/{page}/{rest}" if page and rest.isdecimal() else None
    return Line(record, address, changes(record.before, record.after))


@router.get("/audit", response_class=HTMLResponse)
def audit_page(
    request: Request,
    session: Reading,
    actor: Who,  # noqa: ARG001 - who is not logged in may not read
    verify: str = "",
) -> HTMLResponse:
    """Show a page of records, and the light of the chain."""
    view, found, refusal = read_view(request, RECORDS), Page((), None), ""
    try:
        found = page_of(session, view, **_sought(view))
    except RefusedInputError as error:
        refusal = str(error)
    newest = audit.list_records(session, limit=1)
    blobs = request.app.state.blobs if verify or total_bytes(session) <= READ_AT_EVERY_VISIT else None
    short = not newest or newest[0].id <= VERIFIED_AT_EVERY_VISIT
    return render(
        request,
        "audit/audit.html",
        view=view,
        lines=[line_of(record) for record in found.rows],
        last=found.last,
        refusal=refusal,
        words=audit.words(session),
        chain=audit.verify(session, blobs=blobs, again=False) if short or verify else None,
        light=request.app.state.upkeep.light(),
        head=audit.head(session),
    )


@router.get("/audit.csv")
def audit_csv(request: Request, session: Reading, actor: Who) -> Response:  # noqa: ARG001 - who is known may read
    """Give every record of a view as CSV; the export with its verifier is what proves anything."""
    view = read_view(request, RECORDS)
    return csv_of(view, CSV_FIELDS, (_csv_row(record) for record in all_of(session, view, **_sought(view))))


def _csv_row(record: AuditRecord) -> dict[str, Any]:
    """Lay out a record for a program."""
    told = {"roles": ", ".join(record.roles or ()), "changed": line_of(record).gist}
    names = (name for names in CSV_FIELDS.values() for name in names if name not in told)
    return {name: getattr(record, name) for name in names} | told


@router.get("/audit/{record_id}", response_class=HTMLResponse)
def record_page(
    request: Request,
    session: Reading,
    actor: Who,  # noqa: ARG001 - who is not logged in may not read
    record_id: int,
) -> HTMLResponse:
    """Show one record whole: what it changed member by member, who did it how, and the rows that it sealed."""
    record = audit.get_record(session, record_id)
    return render(
        request, "audit/audit_record.html", line=line_of(record), record=record, sealed=sorted(record.rows or {})
    )
