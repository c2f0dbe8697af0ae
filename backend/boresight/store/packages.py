"""Queries on uplink packages and on what is said of a set inside one."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import Package, ParameterSet, Promotion


def packages(
    session: Session,
    *,
    parameter_set_id: int | None = None,
    sensor_id: int | None = None,
    before_id: int | None = None,
    limit: int | None,
) -> Sequence[Package]:
    """Return a page of packages, newest first."""
    query = sa.select(Package).order_by(Package.id.desc()).limit(limit)
    if parameter_set_id is not None:
        query = query.where(Package.parameter_set_id == parameter_set_id)
    if sensor_id is not None:
        query = query.join(ParameterSet).where(ParameterSet.sensor_id == sensor_id)
    if before_id is not None:
        query = query.where(Package.id < before_id)
    return session.scalars(query).all()


def baseline_before(session: Session, row: ParameterSet) -> ParameterSet | None:
    """Return the set that was a sensor's baseline last, apart from this one."""
    query = sa.select(ParameterSet).join(Promotion, Promotion.parameter_set_id == ParameterSet.id)
    query = query.where(Promotion.sensor_id == row.sensor_id, Promotion.parameter_set_id != row.id)
    return session.scalar(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc()).limit(1))


def set_named(session: Session, name: str) -> ParameterSet | None:
    """Return the set of a name."""
    return session.scalar(sa.select(ParameterSet).where(ParameterSet.name == name))
