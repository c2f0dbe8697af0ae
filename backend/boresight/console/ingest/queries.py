"""Queries on ingest policies and decisions."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.console.ingest.tables import FAILED_STATES, IngestDecision, IngestPolicy, TakenObject
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.platform.db.sessions import Session, utc_now

IN_FORCE = ("ACTIVE", "PAUSED")


def find_policy_in_force(session: Session, sensor_id: int) -> IngestPolicy | None:
    """Return the policy of a sensor that is active or paused."""
    query = sa.select(IngestPolicy).where(IngestPolicy.sensor_id == sensor_id, IngestPolicy.state.in_(IN_FORCE))
    return session.scalar(query)


def list_policies_in_force(session: Session, *, paused: bool = False) -> Sequence[IngestPolicy]:
    """Return the policies that are active or paused, or only the paused ones, by sensor."""
    states = ("PAUSED",) if paused else IN_FORCE
    return session.scalars(
        sa.select(IngestPolicy).where(IngestPolicy.state.in_(states)).order_by(IngestPolicy.sensor_id)
    ).all()


def list_policies(session: Session, sensor_id: int) -> Sequence[IngestPolicy]:
    """Return the versions of a sensor's policy, newest first."""
    query = sa.select(IngestPolicy).where(IngestPolicy.sensor_id == sensor_id)
    return session.scalars(query.order_by(IngestPolicy.number.desc())).all()


def read_next_number(session: Session, sensor_id: int) -> int:
    """Return the number of a sensor's next policy."""
    query = sa.select(sa.func.max(IngestPolicy.number)).where(IngestPolicy.sensor_id == sensor_id)
    return (session.scalar(query) or 0) + 1


def find_decision_on(session: Session, sensor_id: int, file_sha256: str) -> IngestDecision | None:
    """Return the newest decision on these bytes of a sensor."""
    query = sa.select(IngestDecision).where(
        IngestDecision.sensor_id == sensor_id, IngestDecision.file_sha256 == file_sha256
    )
    return session.scalar(query.order_by(IngestDecision.id.desc()).limit(1))


def find_asked(session: Session, sensor_id: int) -> IngestDecision | None:
    """Return the decision of a sensor that waits for a person."""
    query = sa.select(IngestDecision).where(IngestDecision.sensor_id == sensor_id, IngestDecision.state == "ASKED")
    return session.scalar(query)


def find_quiet(session: Session, sensor_id: int, now_utc: str) -> IngestDecision | None:
    """Return the newest decision of a sensor that a person answered with WAIT, while that holds."""
    row = IngestDecision
    query = sa.select(row).where(row.sensor_id == sensor_id, row.state == "ANSWERED", row.quiet_until_utc > now_utc)
    return session.scalar(query.order_by(row.id.desc()).limit(1))


def list_asked(session: Session, limit: int) -> Sequence[IngestDecision]:
    """Return the decisions that wait for a person, newest first."""
    query = sa.select(IngestDecision).where(IngestDecision.state == "ASKED")
    return session.scalars(query.order_by(IngestDecision.id.desc()).limit(limit)).all()


def count_asked(session: Session) -> int:
    """Count the decisions that wait for a person."""
    return session.scalar(sa.select(sa.func.count()).where(IngestDecision.state == "ASKED")) or 0


def count_received(session: Session, sensor_id: int, since_utc: str) -> int:
    """Count the files of a sensor that were received since a time."""
    row = IngestDecision
    return (
        session.scalar(sa.select(sa.func.count()).where(row.sensor_id == sensor_id, row.received_utc > since_utc)) or 0
    )


def count_asked_since(session: Session, sensor_id: int, since_utc: str) -> int:
    """Count the decisions of a sensor that asked a person since a time."""
    row = IngestDecision
    asked = sa.and_(row.sensor_id == sensor_id, row.parameter_set_id.is_not(None), row.decided_utc > since_utc)
    return session.scalar(sa.select(sa.func.count()).where(asked)) or 0


def count_failures_in_row(session: Session, sensor_id: int, since_utc: str) -> int:
    """Count the newest decided files of a sensor up to the last one that was judged; of those since a time."""
    row = IngestDecision
    of_sensor = sa.and_(row.sensor_id == sensor_id, row.decided_utc.is_not(None), row.decided_utc > since_utc)
    judged = sa.select(sa.func.max(row.id)).where(of_sensor, row.state.not_in(FAILED_STATES)).scalar_subquery()
    query = sa.select(sa.func.count()).where(of_sensor, row.id > sa.func.coalesce(judged, 0))
    return session.scalar(query) or 0


def list_due(session: Session) -> Sequence[int]:
    """Return the numbers of the decisions whose run has ended, the oldest of each sensor first."""
    query = sa.select(IngestDecision.id).join(Run, Run.id == IngestDecision.run_id)
    query = query.where(IngestDecision.state == "CALIBRATING", Run.state.in_(TERMINAL_RUN_STATES))
    turn = sa.func.row_number().over(partition_by=IngestDecision.sensor_id, order_by=IngestDecision.id)
    return session.scalars(query.order_by(turn, IngestDecision.id)).all()


IN_QUERY = 500  # addresses in one query


def find_taken_objects(session: Session, addresses: Collection[str]) -> set[tuple[str, str]]:
    """Return the versions of objects of the watched bucket that were taken, by address and ETag."""
    asked, found, row = sorted(addresses), set(), TakenObject
    for begin in range(0, len(asked), IN_QUERY):
        query = sa.select(row.address, row.version).where(row.address.in_(asked[begin : begin + IN_QUERY]))
        found |= {(address, version) for address, version in session.execute(query)}
    return found


def note_taken_object(session: Session, address: str, version: str) -> None:
    """Write down that a version of an object was taken."""
    if not find_taken_objects(session, [address]) & {(address, version)}:
        session.put(TakenObject(address=address, version=version, taken_utc=utc_now()))
