"""Queries on the definitions of the tables on board."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import TableDefinition


def definition_in_force(session: Session, sensor_id: int) -> TableDefinition | None:
    """Return a sensor's newest definition."""
    return next(iter(definitions(session, sensor_id, limit=1)), None)


def definitions(
    session: Session, sensor_id: int, *, before_number: int | None = None, limit: int | None
) -> Sequence[TableDefinition]:
    """Return a page of a sensor's definitions, newest first."""
    query = sa.select(TableDefinition).where(TableDefinition.sensor_id == sensor_id)
    if before_number is not None:
        query = query.where(TableDefinition.number < before_number)
    return session.scalars(query.order_by(TableDefinition.number.desc()).limit(limit)).all()
