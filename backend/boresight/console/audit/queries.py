"""What an object of the audit log is called: the log knows its address in the REST API, a person knows its name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable

from boresight.console.access import queries as user_rows
from boresight.console.fleet import queries as sensor_rows
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.telemetry import queries as telemetry_rows
from boresight.platform.audit.subjects import AuditSubject
from boresight.platform.db.sessions import Session


def _read_set_names(session: Session, ids: Collection[int]) -> dict[int, str]:
    return {number: head.name for number, head in set_rows.read_heads(session, ids).items()}


def _read_people(session: Session, ids: Collection[int]) -> dict[int, str]:
    return {user.id: user.printed_name for user in user_rows.list_users(session) if user.id in ids}


#: What reads the names of some rows, by their noun.
NAMED: dict[str, Callable[[Session, Collection[int]], dict[int, str]]] = {
    "parameter-sets": _read_set_names,
    "sensors": sensor_rows.read_names,
    "telemetry-sets": telemetry_rows.read_names,
    "users": _read_people,
}
#: Words before the number of a row that has no name.
NUMBERED = {
    "alarms": "Alarm",
    "alignment-requests": "Request for an alignment",
    "alignments": "Alignment",
    "approvals": "Request",
    "campaigns": "Campaign",
    "change-proposals": "Proposal",
    "import-profiles": "Mapping profile",
    "ingest-decisions": "Ingest decision",
    "ingest-policies": "Ingest policy",
    "keys": "Key",
    "packages": "Package",
    "presets": "Preset",
    "runs": "Run",
    "table-definitions": "Table definition",
    "uplinks": "On-board record",
    "webhooks": "Webhook",
}


def name_subjects(session: Session, subjects: Iterable[AuditSubject]) -> dict[AuditSubject, str]:
    """Return what objects of the log are called; those that are not known here keep the address."""
    found = {subject: str(subject) for subject in subjects}
    asked: dict[str, set[int]] = defaultdict(set)
    for subject in found:
        if subject.id is not None and subject.noun in NAMED:
            asked[subject.noun].add(subject.id)
    names = {noun: NAMED[noun](session, numbers) for noun, numbers in asked.items()}
    for subject in found:
        if subject.id is None:
            continue
        if name := names.get(subject.noun, {}).get(subject.id):
            found[subject] = name if subject.part is None else f"{name}, {_name_part(subject.part)}"
        elif subject.noun in NUMBERED:
            part = subject.part
            thread = f", thread {part.id}" if part is not None and part.noun == "threads" else ""
            found[subject] = f"{NUMBERED[subject.noun]} {subject.id}{thread}"
    return found


def _name_part(part: AuditSubject) -> str:
    return str(part).replace("-", " ").replace("/", " ")
