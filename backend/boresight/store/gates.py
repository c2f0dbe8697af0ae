"""Queries on gate profiles, gate reports and waivers; nothing of them is ever changed."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import GateProfile, GateReport, Run, Waiver


def profiles(
    session: Session, sensor_id: int, *, before_number: int | None = None, limit: int | None
) -> Sequence[GateProfile]:
    """Return a page of a sensor's profiles, newest first."""
    query = sa.select(GateProfile).where(GateProfile.sensor_id == sensor_id)
    if before_number is not None:
        query = query.where(GateProfile.number < before_number)
    return session.scalars(query.order_by(GateProfile.number.desc()).limit(limit)).all()


def newest_profile(session: Session, sensor_id: int) -> GateProfile | None:
    """Return the profile in force; None where the default holds and nobody needed it yet."""
    return next(iter(profiles(session, sensor_id, limit=1)), None)


def newest_report(session: Session, parameter_set_id: int) -> GateReport | None:
    """Return a set's newest gate report, whether or not what it judged has moved since."""
    query = sa.select(GateReport).where(GateReport.parameter_set_id == parameter_set_id)
    return session.scalar(query.order_by(GateReport.id.desc()).limit(1))


def newest_reports(session: Session, parameter_set_ids: Collection[int]) -> dict[int, GateReport]:
    """Return the newest report of each of some sets that has one."""
    newest = sa.select(sa.func.max(GateReport.id)).where(GateReport.parameter_set_id.in_(parameter_set_ids))
    query = sa.select(GateReport).where(GateReport.id.in_(newest.group_by(GateReport.parameter_set_id)))
    return {row.parameter_set_id: row for row in session.scalars(query)}


def report_with(session: Session, parameter_set_id: int, sha256: str) -> GateReport | None:
    """Return a set's newest report with a hash."""
    query = sa.select(GateReport).where(GateReport.parameter_set_id == parameter_set_id, GateReport.sha256 == sha256)
    return session.scalar(query.order_by(GateReport.id.desc()).limit(1))


def waivers(session: Session, parameter_set_ids: Collection[int]) -> Sequence[Waiver]:
    """Return every waiver of some sets, in the order in which they were made."""
    query = sa.select(Waiver).where(Waiver.parameter_set_id.in_(parameter_set_ids))
    return session.scalars(query.order_by(Waiver.id)).all()


def waivers_in_force(session: Session, parameter_set_id: int, now_utc: str) -> Sequence[Waiver]:
    """Return a set's waivers that have not expired, in order."""
    query = sa.select(Waiver).where(Waiver.parameter_set_id == parameter_set_id, Waiver.expires_utc > now_utc)
    return session.scalars(query.order_by(Waiver.id)).all()


def runs_with_results(session: Session, sensor_id: int, limit: int) -> Sequence[Run]:
    """Return a sensor's newest runs that ended with a result, newest first."""
    query = sa.select(Run).where(Run.sensor_id == sensor_id, Run.state == "SUCCEEDED", Run.result_sha256.is_not(None))
    return session.scalars(query.order_by(Run.id.desc()).limit(limit)).all()
