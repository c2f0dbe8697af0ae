"""The audit log: who did what to what, what it changed in words, units and days, and whether the chain of hashes holds.

A short chain is verified at every visit; of a long one the page shows what the server's own walk found last, and
verifies it when asked (`?verify=1`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import KNOWN, Blobs, Reading, Who
from boresight.console.audit.queries import name_subjects
from boresight.console.audit.service import anchor_now
from boresight.console.jobs.dependencies import ServerAnchoring, ServerMaintenance
from boresight.console.operation import RowWithFields
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import make_change, render
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    TablePage,
    TableView,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.errors import RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.blobs.files import count_bytes
from boresight.verdicts.numbers import MISSING, QUANTITIES, grouped, parameter

LONGEST_VALUE = 120
HASH = re.compile(r"[0-9a-f]{64}")
HASH_DIGITS = 8

UNITS = (
    ("_frames_per_s", "frames/s"),
    ("_px", "px"),
    ("_m", "m"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_s", "s"),
    ("_bytes", "B"),
    ("_days", "d"),
)
NAMES = {
    "bound": "Bound",
    "camera_model": "Camera model",
    "covariance": "Covariance",
    "detector": "Detector",
    "four_eyes": "Four-eyes rule enforced",
    "free": "Free parameters",
    "ground_state": "On ground",
    "initial": "Initial",
    "must_change_password": "Must still set their own password",
    "name": "Name",
    "onboard_state": "On board",
    "original_sha256": "File, SHA-256",
    "parameters": "Parameters",
    "password_by": "Password",
    "purpose": "Purpose",
    "result_sha256": "Result, SHA-256",
    "roles": "Roles",
    "run_id": "Run",
    "sensor_id": "Sensor",
    "set_sha256": "Set, SHA-256",
    "incumbent_sha256": "Baseline, SHA-256",
    "run_result_sha256": "Run's result, SHA-256",
    "profile_sha256": "Gate profile, SHA-256",
    "gate_report_sha256": "Gate report, SHA-256",
    "table_definition_sha256": "Table definition, SHA-256",
    "sha256": "SHA-256",
    "shown_sha256": "Hash of what was shown",
    "parameter_set_sha256": "Parameter set, SHA-256",
    "held": "Within forecast",
    "least_stars": "Minimum stars",
    "replay_frames_per_s": "Replay pace",
    "sigma": "Sigma",
    "state": "State",
    "typical_sigma": "Typical sigma",
}


@dataclass(frozen=True)
class ChangedMember:
    """One member of a document, before and after."""

    name: str
    before: str
    after: str
    title: str = ""
    unit: str = ""


def changes(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None) -> list[ChangedMember]:
    """Return the members that differ between two documents, in the order of the newer one."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    names = [*new, *(name for name in old if name not in new)]
    return [
        ChangedMember(
            name,
            _format_member(name, old.get(name)),
            _format_member(name, new.get(name)),
            name_member(name),
            find_unit(name),
        )
        for name in names
        if old.get(name) != new.get(name)
    ]


def _leaves(document: Mapping[str, Any] | None, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk through a document's members, nested ones as `detector.rows`."""
    for name, value in (document or {}).items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def name_member(name: str) -> str:
    """Name a member as people do: `initial.f_m` is `Initial, f`."""
    *way, last = name.split(".")
    if last in QUANTITIES:
        return ", ".join([*(_word(part) for part in way), QUANTITIES[last].symbol])
    return ", ".join(_word(part) for part in (*way, last))


def _word(part: str) -> str:
    """Name one part of a member's path; an unknown name loses its unit and its underscores."""
    if part in NAMES:
        return NAMES[part]
    bare = next((part.removesuffix(suffix) for suffix, _ in (*UNITS, ("_utc", "")) if part.endswith(suffix)), part)
    return (bare[:1].upper() + bare[1:]).replace("_", " ")


def find_unit(name: str) -> str:
    """Return the unit that a member is shown in."""
    last = name.rpartition(".")[2]
    if last in QUANTITIES:
        return QUANTITIES[last].unit
    return next((unit for suffix, unit in UNITS if last.endswith(suffix)), "")


def _format_member(name: str, value: Any) -> str:
    """Format a member for display; a long one is shortened."""
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        last = name.rpartition(".")[2]
        return parameter(value, last) if last in QUANTITIES else _number(value)
    if isinstance(value, list) and all(isinstance(member, str) for member in value):
        return ", ".join(value) or "none"
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return _text(text)


def _number(value: float) -> str:
    """Print a number: counts whole, measures to seven digits."""
    return str(value) if isinstance(value, int) else grouped(f"{value:.7g}")


def _text(text: str) -> str:
    if HASH.fullmatch(text):
        return text[:HASH_DIGITS]
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"


FILTERS = ("object", "actor", "action", "since", "until")
RECORDS = Table(
    "audit",
    "Records",
    (
        TableColumn("number", "No.", "-number", "num", head=True, csv=("id",)),
        TableColumn("time", "Time", "", "tight", csv=("at_utc",)),
        TableColumn("who", "Who, credential", "who", "named", csv=("actor", "credential", "roles")),
        TableColumn("did", "Action, object", "did", "happening", csv=("action", "object")),
        TableColumn("changed", "What changed", "", "words", csv=("changed",)),
        TableColumn("reason", "Reason", "", "words", csv=("reason",)),
        TableColumn("hash", "Hash, request", "", "tight", csv=("hash", "request_id")),
    ),
    dict.fromkeys(FILTERS, is_text),
    "-number",
    kind="audit",
)
VERIFIED_AT_EVERY_VISIT = 1000
READ_AT_EVERY_VISIT = 100_000_000  # bytes of stored files
IN_GIST = 3
GIST_MEMBERS = (
    "name",
    "label",
    "sensor",
    "set",
    "parameter_set",
    "file",
    "verdict",
    "kind",
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
    "alignments": "alignments",
    "alignment-requests": "alignment-requests",
    "alarms": "alarms",
    "change-proposals": "change-proposals",
    "ingest-decisions": "ingest",
}

router = PageRouter()


@dataclass(frozen=True)
class AuditLine:
    """One record as the page lays it out."""

    record: AuditRecord
    address: str | None
    changes: list[ChangedMember]

    @property
    def gist(self) -> str:
        """A summary of the change in one short line; what is not said by its value alone comes with its name."""
        telling = [it for it in self.changes if it.name.rpartition(".")[2] in GIST_MEMBERS]
        return " · ".join(
            ("" if telling else f"{it.title} ") + (f"{it.before} → {it.after}" if it.before != MISSING else it.after)
            for it in (telling or self.changes)[:IN_GIST]
        )


def _sought(view: TableView) -> dict[str, Any]:
    return {"since": None, "until": None, **audit.sought(**{name: view.where.get(name) for name in FILTERS})}


def make_audit_line(record: AuditRecord) -> AuditLine:
    """Lay out a record; its object links to its page where it has one."""
    subject = record.subject
    page = PAGE_OF_NOUN.get(subject.noun)
    address = f"/{page}/{subject.id}" if page and subject.id is not None and subject.part is None else None
    return AuditLine(record, address, changes(record.before, record.after))


@router.get("/audit", response_class=HTMLResponse)
def audit_page(
    request: Request,
    actor: Who,
    session: Reading,
    files: Blobs,
    maintenance: ServerMaintenance,
    anchoring: ServerAnchoring,
    verify: str = "",
) -> HTMLResponse:
    """Show a page of records and the state of the chain."""
    view, found, refusal = read_view(request, RECORDS), TablePage((), None), None
    try:
        found = read_page(session, view, **_sought(view))
    except RefusedInputError as error:
        refusal = error
    newest = audit.list_records(session, limit=1)
    blobs = files if verify or count_bytes(session) <= READ_AT_EVERY_VISIT else None
    short = not newest or newest[0].id <= VERIFIED_AT_EVERY_VISIT
    return render(
        request,
        "audit/audit.html",
        view=view,
        lines=[make_audit_line(record) for record in found.rows],
        called=name_subjects(session, [record.subject for record in found.rows]),
        last=found.last,
        refusal=refusal,
        words=audit.read_words(session),
        chain=audit.verify(session, blobs=blobs, again=False, trust=anchoring.trust()) if short or verify else None,
        anchor=next(iter(audit.list_anchors(session, limit=1)), None),
        overdue=anchoring.find_overdue(session),
        may_anchor="administrator" in actor.roles,
        newest_id=newest[0].id if newest else 0,
        light=maintenance.light(),
        head=audit.head(session),
    )


@router.post("/audit/anchors", response_class=HTMLResponse)
async def anchor_log(
    request: Request, actor: Who, anchoring: ServerAnchoring, maintenance: ServerMaintenance
) -> Response:
    """Sign the newest head."""
    change = partial(anchor_now, actor=actor, key=anchoring.key, broken=maintenance.broken)
    answer = await make_change(request, change, "/audit", "The head of the log is signed.")
    maintenance.nudge()
    return answer


@router.get("/audit.csv", dependencies=[KNOWN])
def audit_csv(request: Request, session: Reading) -> Response:
    """Give every record of a view as CSV; the export with its verifier is what proves anything."""
    view = read_view(request, RECORDS)
    return write_csv(view, (_csv_row(record) for record in read_all(session, view, **_sought(view))))


def _csv_row(record: AuditRecord) -> RowWithFields:
    return RowWithFields(record, roles=", ".join(record.roles or ()), changed=make_audit_line(record).gist)


@router.get("/audit/{record_id}", response_class=HTMLResponse, dependencies=[KNOWN])
def record_page(
    request: Request,
    session: Reading,
    record_id: int,
) -> HTMLResponse:
    """Show one record in full: what it changed, who made it and how, and the rows that it sealed."""
    record = audit.get_record(session, record_id)
    return render(
        request,
        "audit/audit_record.html",
        line=make_audit_line(record),
        record=record,
        sealed=sorted(record.rows or {}),
    )
