"""Counts and oldest times over the whole installation, each one statement, for `/metrics`."""

from __future__ import annotations

import sqlalchemy as sa

from boresight.console.alarms.queries import in_state
from boresight.console.alarms.tables import Alarm
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.ingest.tables import IngestDecision
from boresight.console.messages.tables import Message
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run
from boresight.console.webhooks.tables import WebhookDelivery
from boresight.platform.db.sessions import Session


def list_oldest_baselines(session: Session, limit: int) -> list[tuple[str, str | None]]:
    """Return sensor and begin of the baselines that are in force longest, oldest first."""
    query = (
        sa.select(Sensor.name, ParameterSet.baseline_from_utc)
        .join(ParameterSet, ParameterSet.sensor_id == Sensor.id)
        .where(ParameterSet.ground_state == "BASELINE", ParameterSet.baseline_from_utc.is_not(None))
        .order_by(ParameterSet.baseline_from_utc)
        .limit(limit)
    )
    return [(name, since_utc) for name, since_utc in session.execute(query)]


def count_without_baseline(session: Session) -> int:
    """Count the sensors that have no baseline."""
    has = sa.exists().where(ParameterSet.sensor_id == Sensor.id, ParameterSet.ground_state == "BASELINE")
    return session.scalar(sa.select(sa.func.count()).select_from(Sensor).where(~has)) or 0


def count_open_alarms(session: Session) -> dict[tuple[str, str, str], int]:
    """Count the alarms that are not closed, by kind, level and state."""
    counts = {}
    for state in ("unacknowledged", "acknowledged", "shelved"):
        query = sa.select(Alarm.kind, Alarm.level, sa.func.count()).where(in_state(state))
        for kind, level, count in session.execute(query.group_by(Alarm.kind, Alarm.level)):
            counts[kind, level, state] = count
    return counts


def read_open_approvals(session: Session) -> tuple[int, str | None]:
    """Return how many requests wait for signatures, and since when the oldest."""
    query = sa.select(sa.func.count(), sa.func.min(Approval.submitted_utc)).where(Approval.state == "OPEN")
    row = session.execute(query).one()
    return row[0], row[1]


def read_queue(session: Session) -> str | None:
    """Return since when the oldest queued run waits."""
    return session.scalar(sa.select(Run.launched_utc).where(Run.state == "QUEUED").order_by(Run.id).limit(1))


def count_asked_decisions(session: Session) -> int:
    """Count the ingest decisions that wait for a person."""
    query = sa.select(sa.func.count()).select_from(IngestDecision).where(IngestDecision.state == "ASKED")
    return session.scalar(query) or 0


def count_undelivered(session: Session, table: type[WebhookDelivery | Message]) -> dict[str, int]:
    """Count what waits and what was given up; what was delivered is most, and counting it would take long."""
    counts = dict.fromkeys(("PENDING", "FAILED"), 0)
    query = sa.select(table.state, sa.func.count()).where(table.state.in_(counts)).group_by(table.state)
    return counts | {state: count for state, count in session.execute(query)}  # noqa: C416 - rows are not pairs to a type checker
