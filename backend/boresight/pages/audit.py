"""The audit log: who did what to what, with what changed, and whether the chain of hashes holds.

The address holds the view: `?object=parameter-sets/3&before=812`. A short chain is verified at every visit; a long one
when asked (`?verify=1`), for every record must be read.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.pages.rendering import render
from boresight.services import audit
from boresight.store.tables import AuditRecord

RECORDS_A_PAGE = 50
VERIFIED_AT_EVERY_VISIT = 5000
LONGEST_VALUE = 120
HASH = re.compile(r"[0-9a-f]{64}")
HASH_DIGITS = 8
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
class Change:
    """One member of a document, before and after."""

    name: str
    before: str
    after: str


def _leaves(document: Mapping[str, Any] | None, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk through a document's members, nested ones as `detector.rows`."""
    for name, value in (document or {}).items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _shown(value: Any) -> str:
    """Print a member for people; a long one is cut."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, list) and all(isinstance(member, str) for member in value):
        return ", ".join(value)
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    if HASH.fullmatch(text):
        return text[:HASH_DIGITS]
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"


def changes(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> list[Change]:
    """Return the members that differ between two documents, in the order of the newer one."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    names = [*new, *(name for name in old if name not in new)]
    return [
        Change(name, _shown(old.get(name)), _shown(new.get(name))) for name in names if old.get(name) != new.get(name)
    ]


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
    object: str = "",  # noqa: A002 - the name in the address
    before: str = "",
    verify: str = "",
) -> HTMLResponse:
    """Show a page of records, newest first, and the light of the chain."""
    before_id = int(before) if before.isdecimal() else None
    subject = object.strip()
    found = audit.list_records(session, before_id=before_id, subject=subject or None, limit=RECORDS_A_PAGE + 1)
    newest = audit.list_records(session, limit=1)
    short = not newest or newest[0].id <= VERIFIED_AT_EVERY_VISIT
    shown = found[:RECORDS_A_PAGE]
    older = {"object": subject, "before": shown[-1].id} if len(found) > RECORDS_A_PAGE else None
    return render(
        request,
        "audit.html",
        lines=[line_of(record) for record in shown],
        subject=subject,
        later=before_id is not None,
        older_query=urlencode(older) if older else "",
        chain=audit.verify(session) if short or verify else None,
        head=audit.head(session),
    )
