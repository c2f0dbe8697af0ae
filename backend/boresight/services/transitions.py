"""What every change of state has in common: the version that was seen, the move, the hashes an approval binds."""

from __future__ import annotations

from typing import Any

from boresight.errors import PreconditionRequiredError, StaleError
from boresight.services import audit
from boresight.services.actors import Actor
from boresight.store import parameter_sets as set_rows
from boresight.store.sessions import Session
from boresight.store.tables import Approval, ParameterSet, Run, Sensor

Versioned = Approval | ParameterSet | Sensor


def subject_of(row: Versioned) -> str:
    """Name a row as the audit log does, by its REST address."""
    noun = {Approval: "approvals", ParameterSet: "parameter-sets", Sensor: "sensors"}[type(row)]
    return f"{noun}/{row.id}"


def label_of(row: Versioned) -> str:
    """Name a row as people do."""
    return f"Request {row.id}" if isinstance(row, Approval) else row.name


def require_seen(session: Session, row: Versioned, seen_version: int | None) -> None:
    """Refuse a change by someone who did not see the row as it is.

    Raises
    ------
    PreconditionRequiredError
        When no version was given.
    StaleError
        When the row changed since; says who changed what and when.
    """
    if seen_version is None:
        raise PreconditionRequiredError(f'Say which version of {label_of(row)} you saw: If-Match: "v<number>".')
    if seen_version != row.version:
        raise StaleError(
            f"{label_of(row)} has changed since you looked (you saw v{seen_version}, it is v{row.version}): "
            f"{who_changed(session, row)}. Reload, look again and decide."
        )


def who_changed(session: Session, row: Versioned) -> str:
    """Say who changed a row last, what and when."""
    record = audit.last_change(session, subject_of(row))
    return f"{record.actor} {record.action} it at {record.at_utc}" if record else "nobody is on record for it"


def move(
    session: Session, actor: Actor, row: Approval | ParameterSet, state: str, action: str, *, reason: str | None = None
) -> None:
    """Bring a row into a state, one version further, with its audit record."""
    column = "state" if isinstance(row, Approval) else "ground_state"
    before = {column: getattr(row, column), "version": row.version}
    setattr(row, column, state)
    row.version += 1
    after: dict[str, Any] = {column: state, "version": row.version}
    if isinstance(row, ParameterSet):
        after["sha256"] = row.sha256
    audit.append(session, actor, action, subject_of(row), before, after, reason)


def resting_state(parameter_set: ParameterSet, otherwise: str) -> str:
    """Return where a set goes when its request ends without a promotion: a former baseline stays SUPERSEDED."""
    return otherwise if parameter_set.baseline_from_utc is None else "SUPERSEDED"


def bound_hashes(session: Session, parameter_set: ParameterSet) -> dict[str, str | None]:
    """Return the hashes of what an approver is shown: the set, its run's result, the baseline it would replace."""
    run = None if parameter_set.run_id is None else session.get(Run, parameter_set.run_id)
    incumbent = set_rows.baseline(session, parameter_set.sensor_id)
    return {
        "set_sha256": parameter_set.sha256,
        "run_result_sha256": None if run is None else run.result_sha256,
        "incumbent_sha256": None if incumbent is None else incumbent.sha256,
    }
