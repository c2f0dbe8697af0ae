"""The audit log: who did what to what, with what changed, and whether the chain of hashes holds.

The address holds the view: `?object=parameter-sets/3&actor=Ana+Lima&action=promoted&since=2026-11-01&before=812`. A
short chain is verified at every visit; of a long one the page shows what the server's own walk found last, and verifies
it when asked (`?verify=1`), for every record and every sealed row must be read.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.errors import RefusedInputError
from boresight.pages.audit_changes import Change, changes
from boresight.pages.rendering import render
from boresight.services import audit
from boresight.store.sessions import Session
from boresight.store.tables import AuditRecord

RECORDS_A_PAGE = 50
VERIFIED_AT_EVERY_VISIT = 1000
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


@dataclass(frozen=True)
class Filters:
    """What the address narrows the list to; empty is everything."""

    object: str = ""
    actor: str = ""
    action: str = ""
    since: str = ""
    until: str = ""

    def records(self, session: Session, before_id: int | None) -> tuple[list[AuditRecord], str]:
        """Return a page of records, one more than is shown, and why a filter was refused; then the list is empty."""
        given = {name: text.strip() or None for name, text in asdict(self).items()}
        try:
            sought = audit.sought(**given)
        except RefusedInputError as error:
            return [], str(error)
        return list(audit.list_records(session, before_id=before_id, sought=sought, limit=RECORDS_A_PAGE + 1)), ""

    def query(self, **more: Any) -> str:
        """Return the query of an address with these filters and more."""
        return urlencode({name: value for name, value in (asdict(self) | more).items() if value})


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
    before: str = "",
    verify: str = "",
) -> HTMLResponse:
    """Show a page of records, newest first, and the light of the chain."""
    before_id = int(before) if before.isdecimal() else None
    asked = request.query_params
    filters = Filters(*(asked.get(name, "")[:200] for name in Filters.__dataclass_fields__))
    found, refusal = filters.records(session, before_id)
    newest = audit.list_records(session, limit=1)
    short = not newest or newest[0].id <= VERIFIED_AT_EVERY_VISIT
    shown = found[:RECORDS_A_PAGE]
    return render(
        request,
        "audit.html",
        lines=[line_of(record) for record in shown],
        filters=filters,
        refusal=refusal,
        words=audit.words(session),
        later=before_id is not None,
        older_query=filters.query(before=shown[-1].id) if len(found) > RECORDS_A_PAGE else "",
        chain=audit.verify(session) if short or verify else None,
        light=request.app.state.upkeep.light(),
        head=audit.head(session),
    )


@router.get("/audit/{record_id}", response_class=HTMLResponse)
def record_page(
    request: Request,
    session: Reading,
    actor: Who,  # noqa: ARG001 - who is not logged in may not read
    record_id: int,
) -> HTMLResponse:
    """Show one record whole: what it changed member by member, who did it how, and the rows that it sealed."""
    record = audit.get_record(session, record_id)
    return render(request, "audit_record.html", line=line_of(record), record=record, sealed=sorted(record.rows or {}))
