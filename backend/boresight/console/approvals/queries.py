"""Queries on requests for approval and the evidence that they bind, on gates and their waivers."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.console.approvals.tables import (
    Approval,
    FigureDelivery,
    GateProfile,
    GateReport,
    Opening,
    Remark,
    Signature,
    Thread,
    Waiver,
)
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import CALIBRATIONS, Run
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session

UNDECIDED = ("OPEN", "APPROVED")  # states that a promotion of another set makes stale


def list_submitter_ids(session: Session, states: Collection[str]) -> frozenset[int]:
    """Return who submitted the requests that are in one of these states."""
    return frozenset(session.scalars(sa.select(Approval.submitted_by).where(Approval.state.in_(states)).distinct()))


def find_latest_approval(session: Session, parameter_set_id: int, *states: str) -> Approval | None:
    """Return a set's newest request in one of these states."""
    query = sa.select(Approval).where(Approval.parameter_set_id == parameter_set_id, Approval.state.in_(states))
    return session.scalar(query.order_by(Approval.id.desc()).limit(1))


def list_undecided_of_sensor(session: Session, sensor_id: int) -> Sequence[Approval]:
    """Return a sensor's requests that are not decided, with those approved and not yet promoted."""
    return session.scalars(_undecided().where(ParameterSet.sensor_id == sensor_id)).all()


def list_due_approvals(session: Session, now_utc: str) -> Sequence[Approval]:
    """Return the requests that are not decided, or approved and not yet promoted, and whose time is over."""
    return session.scalars(_undecided().where(Approval.expires_utc <= now_utc)).all()


def _undecided() -> sa.Select[Approval]:
    """Select the requests that are not decided, with those approved and not yet promoted, and their sets."""
    live = ParameterSet.ground_state.in_(("SUBMITTED", "APPROVED"))
    newest = sa.select(sa.func.max(Approval.id)).group_by(Approval.parameter_set_id)  # older ones have been promoted
    query = sa.select(Approval).join(ParameterSet).where(Approval.state.in_(UNDECIDED), live, Approval.id.in_(newest))
    return query.order_by(Approval.id)


def read_newest_open(session: Session, sensor_ids: Collection[int]) -> dict[int, int]:
    """Return the number of the newest open request of each of some sensors that has any, by sensor."""
    query = sa.select(ParameterSet.sensor_id, sa.func.max(Approval.id)).join(Approval)
    query = query.where(Approval.state == "OPEN", among(ParameterSet.sensor_id, sensor_ids))
    return {row[0]: row[1] for row in session.execute(query.group_by(ParameterSet.sensor_id))}


def list_signatures(session: Session, approval_id: int) -> Sequence[Signature]:
    """Return who signed a request, in order."""
    return session.scalars(
        sa.select(Signature).where(Signature.approval_id == approval_id).order_by(Signature.id)
    ).all()


def find_signature(session: Session, approval_id: int, user_id: int) -> Signature | None:
    """Return a person's signature on a request."""
    query = sa.select(Signature).where(Signature.approval_id == approval_id)
    return session.scalar(query.where(Signature.user_id == user_id))


def list_remarks(session: Session, approval_id: int) -> Sequence[Remark]:
    """Return what was said about a request as a whole, in order."""
    of_all = (Remark.approval_id == approval_id, Remark.thread_id.is_(None))
    return session.scalars(sa.select(Remark).where(*of_all).order_by(Remark.id)).all()


def list_mentioning_remarks(session: Session) -> Sequence[Remark]:
    """Return the remarks that mention somebody, in order, of the requests that are not decided."""
    query = sa.select(Remark).join(Approval, Remark.approval_id == Approval.id)
    query = query.where(Approval.state.in_(UNDECIDED), Remark.mentions.is_not(None))
    return session.scalars(query.order_by(Remark.id)).all()


def list_answers(session: Session, approval_ids: Collection[int]) -> Sequence[sa.Row[int, int, int | None, int]]:
    """Return number, request, thread and author of everything said about some requests."""
    query = sa.select(Remark.id, Remark.approval_id, Remark.thread_id, Remark.user_id)
    return session.execute(query.where(among(Remark.approval_id, approval_ids))).all()


def list_resolved_threads(session: Session, approval_ids: Collection[int]) -> frozenset[int]:
    """Return the numbers of the resolved threads of some requests."""
    query = sa.select(Thread.id).where(Thread.state == "RESOLVED", among(Thread.approval_id, approval_ids))
    return frozenset(session.scalars(query))


def list_threads(session: Session, approval_id: int) -> Sequence[Thread]:
    """Return the threads of a request, in order."""
    return session.scalars(sa.select(Thread).where(Thread.approval_id == approval_id).order_by(Thread.id)).all()


def list_openings(session: Session, approval_id: int) -> Sequence[Opening]:
    """Return who opened which evidence of a request, in order."""
    return session.scalars(sa.select(Opening).where(Opening.approval_id == approval_id).order_by(Opening.id)).all()


def find_delivery(session: Session, approval_id: int, user_id: int, evidence: str) -> FigureDelivery | None:
    """Return when a person was given a figure of a request."""
    query = sa.select(FigureDelivery).where(FigureDelivery.approval_id == approval_id)
    return session.scalar(query.where(FigureDelivery.user_id == user_id, FigureDelivery.evidence == evidence))


def find_opening(session: Session, approval_id: int, user_id: int, evidence: str) -> Opening | None:
    """Return when a person first opened a piece of evidence."""
    query = sa.select(Opening).where(Opening.approval_id == approval_id, Opening.user_id == user_id)
    return session.scalar(query.where(Opening.evidence == evidence))


def list_profiles(
    session: Session, sensor_id: int, limit: int | None = None, *, until: int | None = None
) -> Sequence[GateProfile]:
    """Return a sensor's profiles, newest first; at most `limit`, from the version `until` back."""
    query = sa.select(GateProfile).where(GateProfile.sensor_id == sensor_id)
    if until is not None:
        query = query.where(GateProfile.number <= until)
    return session.scalars(query.order_by(GateProfile.number.desc()).limit(limit)).all()


def find_newest_profile(session: Session, sensor_id: int) -> GateProfile | None:
    """Return the profile in force; None where the default is in force and not stored yet."""
    return next(iter(list_profiles(session, sensor_id, limit=1)), None)


def find_newest_report(session: Session, parameter_set_id: int, sha256: str | None = None) -> GateReport | None:
    """Return a set's newest gate report, of all or of those with a hash, valid or not."""
    query = sa.select(GateReport).where(GateReport.parameter_set_id == parameter_set_id)
    if sha256 is not None:
        query = query.where(GateReport.sha256 == sha256)
    return session.scalar(query.order_by(GateReport.id.desc()).limit(1))


def list_newest_reports(session: Session, parameter_set_ids: Collection[int]) -> dict[int, GateReport]:
    """Return the newest report of each of some sets that has one."""
    newest = sa.select(sa.func.max(GateReport.id)).where(GateReport.parameter_set_id.in_(parameter_set_ids))
    query = sa.select(GateReport).where(GateReport.id.in_(newest.group_by(GateReport.parameter_set_id)))
    return {row.parameter_set_id: row for row in session.scalars(query)}


def list_waivers(session: Session, parameter_set_ids: Collection[int]) -> Sequence[Waiver]:
    """Return every waiver of some sets, in the order in which they were made."""
    query = sa.select(Waiver).where(Waiver.parameter_set_id.in_(parameter_set_ids))
    return session.scalars(query.order_by(Waiver.id)).all()


def list_waivers_in_force(session: Session, parameter_set_id: int, now_utc: str) -> Sequence[Waiver]:
    """Return a set's waivers that have not expired, in order."""
    query = sa.select(Waiver).where(Waiver.parameter_set_id == parameter_set_id, Waiver.expires_utc > now_utc)
    return session.scalars(query.order_by(Waiver.id)).all()


def list_runs_with_results(session: Session, sensor_id: int, limit: int) -> Sequence[Run]:
    """Return a sensor's newest runs that ended with a result, newest first."""
    query = sa.select(Run).where(Run.sensor_id == sensor_id, Run.state == "SUCCEEDED", CALIBRATIONS)
    query = query.where(Run.result_sha256.is_not(None))
    return session.scalars(query.order_by(Run.id.desc()).limit(limit)).all()
