"""Queries on alignments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import defer

from boresight.console.alignments.tables import Alignment, AlignmentRequest
from boresight.console.runs.tables import CALIBRATIONS, Run
from boresight.platform.db.sessions import Session


def count_waiting(session: Session) -> int:
    """Count the alignments that have not ended."""
    query = sa.select(sa.func.count()).where(Alignment.state.in_(("QUEUED", "RUNNING")))
    return session.scalar(query) or 0


def is_any_due(session: Session, now_utc: str) -> bool:
    """Whether an alignment waits, or was left by a server that is gone."""
    return session.scalar(sa.select(Alignment.id).where(_due(now_utc)).limit(1)) is not None


def find_due(session: Session, now_utc: str) -> Alignment | None:
    """Return the oldest alignment that waits, or was left by a server that is gone."""
    return session.scalar(sa.select(Alignment).where(_due(now_utc)).order_by(Alignment.id).limit(1))


def _due(now_utc: str) -> sa.ColumnElement[bool]:
    lapsed = sa.and_(Alignment.state == "RUNNING", Alignment.lease_until_utc < now_utc)
    return sa.or_(Alignment.state == "QUEUED", lapsed)


def find_under_way(session: Session, run_a_id: int, run_b_id: int, options: Mapping[str, Any]) -> Alignment | None:
    """Return the alignment of the same runs with the same options that has not ended."""
    row = Alignment
    query = sa.select(row).where(
        row.run_a_id == run_a_id, row.run_b_id == run_b_id, row.state.in_(("QUEUED", "RUNNING"))
    )
    return next((found for found in session.scalars(query) if found.options == dict(options)), None)


def list_of_pair(session: Session, sensor_a_id: int, sensor_b_id: int, limit: int) -> Sequence[Alignment]:
    """Return the newest alignments from one sensor to another that have a result, newest first."""
    of_pair = sa.and_(Alignment.sensor_a_id == sensor_a_id, Alignment.sensor_b_id == sensor_b_id)
    query = sa.select(Alignment).where(of_pair, Alignment.state == "SUCCEEDED")
    return session.scalars(query.order_by(Alignment.id.desc()).limit(limit)).all()


def list_usable_runs(session: Session, most_of_sensor: int) -> Sequence[Run]:
    """Return the newest calibrations of each sensor that succeeded, newest first."""
    age = sa.func.row_number().over(partition_by=Run.sensor_id, order_by=Run.id.desc()).label("age")
    ranked = sa.select(Run.id, age).where(Run.state == "SUCCEEDED", CALIBRATIONS).subquery()
    query = sa.select(Run).join(ranked, ranked.c.id == Run.id).where(ranked.c.age <= most_of_sensor)
    return session.scalars(query.order_by(Run.id.desc()).options(defer(Run.sensor_document))).all()


def list_requests(session: Session, alignment_id: int) -> Sequence[AlignmentRequest]:
    """Return the requests for an alignment, newest first."""
    query = sa.select(AlignmentRequest).where(AlignmentRequest.alignment_id == alignment_id)
    return session.scalars(query.order_by(AlignmentRequest.id.desc())).all()


def read_open_requests(session: Session) -> tuple[int, str | None]:
    """Return how many requests wait for a signature, and since when the oldest."""
    query = sa.select(sa.func.count(), sa.func.min(AlignmentRequest.submitted_utc))
    row = session.execute(query.where(AlignmentRequest.state == "OPEN")).one()
    return row[0], row[1]


def find_request_in_force(session: Session, alignment_id: int) -> AlignmentRequest | None:
    """Return the request for an alignment that is open or approved."""
    row = AlignmentRequest
    query = sa.select(row).where(row.alignment_id == alignment_id, row.state.in_(("OPEN", "APPROVED")))
    return session.scalar(query)


def find_approved(session: Session, run_id: int) -> tuple[Alignment, AlignmentRequest] | None:
    """Return the alignment from the sensor of a run, made with that run, that was approved last."""
    query = (
        sa.select(Alignment, AlignmentRequest)
        .join(AlignmentRequest, AlignmentRequest.alignment_id == Alignment.id)
        .where(Alignment.run_a_id == run_id, AlignmentRequest.state == "APPROVED")
        .order_by(AlignmentRequest.closed_utc.desc(), AlignmentRequest.id.desc())
        .limit(1)
    )
    found = session.execute(query).first()
    return None if found is None else (found[0], found[1])
