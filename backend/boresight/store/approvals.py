"""Queries on requests for approval, their signatures, their discussion and the evidence that they bind."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.store.documents import among
from boresight.store.sessions import Session
from boresight.store.tables import (
    Approval,
    Opening,
    ParameterSet,
    Remark,
    Signature,
)

UNDECIDED = ("OPEN", "APPROVED")  # states that a promotion of another set makes stale


def submitters(session: Session, states: Collection[str]) -> frozenset[int]:
    """Return who submitted the requests that are in one of these states."""
    return frozenset(session.scalars(sa.select(Approval.submitted_by).where(Approval.state.in_(states)).distinct()))


def latest_of(session: Session, parameter_set_id: int, *states: str) -> Approval | None:
    """Return a set's newest request in one of these states."""
    query = sa.select(Approval).where(Approval.parameter_set_id == parameter_set_id, Approval.state.in_(states))
    return session.scalar(query.order_by(Approval.id.desc()).limit(1))


def undecided_of_sensor(session: Session, sensor_id: int) -> Sequence[Approval]:
    """Return a sensor's requests that are not decided, with those approved and not yet promoted."""
    return session.scalars(_undecided().where(ParameterSet.sensor_id == sensor_id)).all()


def due(session: Session, now_utc: str) -> Sequence[Approval]:
    """Return the requests that are not decided, or approved and not yet promoted, and whose time is over."""
    return session.scalars(_undecided().where(Approval.expires_utc <= now_utc)).all()


def _undecided() -> sa.Select[Approval]:
    """Select the requests that are not decided, with those approved and not yet promoted, and their sets."""
    live = ParameterSet.ground_state.in_(("SUBMITTED", "APPROVED"))
    newest = sa.select(sa.func.max(Approval.id)).group_by(Approval.parameter_set_id)  # an older one had its promotion
    query = sa.select(Approval).join(ParameterSet).where(Approval.state.in_(UNDECIDED), live, Approval.id.in_(newest))
    return query.order_by(Approval.id)


def approvals(
    session: Session, *, state: str | None, parameter_set_id: int | None, before_id: int | None, limit: int | None
) -> Sequence[Approval]:
    """Return a page of requests, newest first."""
    query = sa.select(Approval).order_by(Approval.id.desc()).limit(limit)
    if state is not None:
        query = query.where(Approval.state == state)
    if parameter_set_id is not None:
        query = query.where(Approval.parameter_set_id == parameter_set_id)
    if before_id is not None:
        query = query.where(Approval.id < before_id)
    return session.scalars(query).all()


def newest_open(session: Session, sensor_ids: Collection[int]) -> dict[int, int]:
    """Return the number of the newest open request of each of some sensors that has any, by sensor."""
    query = sa.select(ParameterSet.sensor_id, sa.func.max(Approval.id)).join(Approval)
    query = query.where(Approval.state == "OPEN", among(ParameterSet.sensor_id, sensor_ids))
    return {row[0]: row[1] for row in session.execute(query.group_by(ParameterSet.sensor_id))}


def signatures(session: Session, approval_id: int) -> Sequence[Signature]:
    """Return who signed a request, in order."""
    return session.scalars(
        sa.select(Signature).where(Signature.approval_id == approval_id).order_by(Signature.id)
    ).all()


def signature_of(session: Session, approval_id: int, user_id: int) -> Signature | None:
    """Return a person's signature on a request."""
    query = sa.select(Signature).where(Signature.approval_id == approval_id)
    return session.scalar(query.where(Signature.user_id == user_id))


def remarks(session: Session, approval_id: int) -> Sequence[Remark]:
    """Return what was said about a request, in order."""
    return session.scalars(sa.select(Remark).where(Remark.approval_id == approval_id).order_by(Remark.id)).all()


def openings(session: Session, approval_id: int) -> Sequence[Opening]:
    """Return who opened which evidence of a request, in order."""
    return session.scalars(sa.select(Opening).where(Opening.approval_id == approval_id).order_by(Opening.id)).all()


def opening_of(session: Session, approval_id: int, user_id: int, evidence: str) -> Opening | None:
    """Return when a person first opened a piece of evidence."""
    query = sa.select(Opening).where(Opening.approval_id == approval_id, Opening.user_id == user_id)
    return session.scalar(query.where(Opening.evidence == evidence))
