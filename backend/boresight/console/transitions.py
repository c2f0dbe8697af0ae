"""Changes of state: checking the version that the client saw, changing the row, and adding the audit record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.console.alarms.tables import ALARM_VERBS, Alarm
from boresight.console.alignments.tables import AlignmentRequest
from boresight.console.approvals.tables import Approval, Thread
from boresight.console.change_proposals.tables import ChangeProposal
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.parameter_sets import queries as rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import PreconditionRequiredError, RefusedInputError, StaleError
from boresight.platform.actors import Actor
from boresight.platform.audit import log as audit
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session

Versioned = (
    Alarm
    | AlignmentRequest
    | Approval
    | ChangeProposal
    | IngestDecision
    | IngestPolicy
    | ParameterSet
    | Sensor
    | Thread
)


@dataclass(frozen=True)
class DocumentInForce:
    """The version in force of a gate profile or table definition: its title, audit object, number and hash."""

    title: str
    subject: str | None
    number: int
    sha256: str | None


def name_subject(row: Versioned) -> str:
    """Return a row's name in the audit log, its REST address."""
    if isinstance(row, Thread):
        return f"approvals/{row.approval_id}/threads/{row.id}"
    nouns: dict[type, str] = {
        Alarm: "alarms",
        AlignmentRequest: "alignment-requests",
        Approval: "approvals",
        ChangeProposal: "change-proposals",
        IngestDecision: "ingest-decisions",
        IngestPolicy: "ingest-policies",
        ParameterSet: "parameter-sets",
        Sensor: "sensors",
    }
    noun = nouns[type(row)]
    return f"{noun}/{row.id}"


def make_label(row: Versioned) -> str:
    """Return a row's name for people."""
    if isinstance(row, Alarm):
        return f"Alarm {row.id}"
    if isinstance(row, ChangeProposal):
        return f"Proposal {row.id}"
    if isinstance(row, IngestDecision):
        return f"Decision {row.id}"
    if isinstance(row, IngestPolicy):
        return f"Policy {row.number}"
    if isinstance(row, Thread):
        return f"Thread {row.id}"
    return f"Request {row.id}" if isinstance(row, AlignmentRequest | Approval) else row.name


def require_seen(session: Session, row: Versioned, seen_version: int | None) -> None:
    """Refuse a change by someone who saw an older version of the row."""
    if seen_version is None:
        raise PreconditionRequiredError(f'Say which version of {make_label(row)} you saw: If-Match: "v<number>".')
    if seen_version != row.version:
        raise StaleError(
            f"{make_label(row)} has changed since you read it (you saw v{seen_version}, it is now v{row.version}): "
            f"{describe_last_change(session, row)}. Reload the page, check the changes and decide again.",
            code="changed-since-read",
        )


def require_seen_document(session: Session, current: DocumentInForce, seen_number: int | None) -> None:
    """Refuse a change by someone who saw another document than the one in force."""
    if seen_number is None:
        raise PreconditionRequiredError(
            f'Say which version of the {current.title} you saw: If-Match: "v<number>", "v0" for the first.'
        )
    if seen_number != current.number:
        record = None if current.subject is None else audit.find_last_change(session, current.subject)
        by = "" if record is None else f": {record.actor} {record.action} it at {record.at_utc}"
        raise StaleError(
            f"The {current.title} has changed since you read it (you saw v{seen_number}, it is now v{current.number}){by}. "
            "Reload the page, check the changes and decide again.",
            code="changed-since-read",
        )


def require_change(current: DocumentInForce, document: Mapping[str, Any], reason: str) -> None:
    """Refuse a document without a reason, and the one that is in force already."""
    if not reason.strip():
        raise RefusedInputError(f"Give the reason why the {current.title} changes.", code="reason-missing")
    if compute_sha256(dict(document)) == current.sha256:
        raise RefusedInputError(
            f"This is identical to version {current.number} of the {current.title}, which is already in force: change it first.",
            code="already-in-force",
        )


def describe_last_change(session: Session, row: Versioned) -> str:
    """Describe who changed a row last, how and when."""
    record = audit.find_last_change(session, name_subject(row))
    if record is None:
        return "no change is on record"
    return f"{record.actor} {ALARM_VERBS.get(record.action, record.action)} it at {record.at_utc}"


def describe_baseline(session: Session, sensor_id: int) -> str:
    """Describe which set is the baseline and who promoted it; empty where there is none."""
    row = rows.find_baseline(session, sensor_id)
    return f" The baseline is {row.name}: {describe_last_change(session, row)}." if row else ""


def move(
    session: Session,
    actor: Actor,
    row: AlignmentRequest | Approval | ChangeProposal | IngestDecision | IngestPolicy | ParameterSet | Thread,
    state: str,
    action: str,
    *,
    reason: str | None = None,
    **told: Any,
) -> None:
    """Change a row's state, increase its version, and add the audit record."""
    column = "ground_state" if isinstance(row, ParameterSet) else "state"
    before = {column: getattr(row, column), "version": row.version}
    setattr(row, column, state)
    row.version += 1
    after: dict[str, Any] = {column: state, "version": row.version, **told}
    if isinstance(row, ParameterSet):
        after["sha256"] = row.sha256
    audit.append(session, actor, action, name_subject(row), before, after, reason)


def resting_state(parameter_set: ParameterSet, otherwise: str) -> str:
    """Return where a set goes when its request ends without a promotion: a former baseline stays SUPERSEDED."""
    return otherwise if parameter_set.baseline_from_utc is None else "SUPERSEDED"
