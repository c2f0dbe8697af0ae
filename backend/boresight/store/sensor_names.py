"""Queries on the names of sensors alone: a row carries a document, and a list to choose from needs none."""

from __future__ import annotations

from collections.abc import Collection

import sqlalchemy as sa

from boresight.store import seals
from boresight.store.lists import MOST_NUMBER
from boresight.store.sessions import Session
from boresight.store.tables import Sensor


def names(session: Session, sensor_ids: Collection[int] | None) -> dict[int, str]:
    """Return the names of sensors by their numbers; of all where None is given."""
    query = sa.select(Sensor.id, Sensor.name)
    if sensor_ids is None:
        return {row[0]: row[1] for row in session.execute(query)}
    wanted = sorted(number for number in set(sensor_ids) if 0 < number < MOST_NUMBER)
    return {
        row[0]: row[1] for some in seals.portions(wanted) for row in session.execute(query.where(Sensor.id.in_(some)))
    }


def holding(session: Session, text: str, limit: int) -> dict[int, str]:
    """Return the first sensors by name whose name holds a text in letters of either case, their names by their numbers."""
    query = sa.select(Sensor.id, Sensor.name).where(*_holding(text)).order_by(Sensor.name).limit(limit)
    return {row[0]: row[1] for row in session.execute(query)}


def count_holding(session: Session, text: str) -> int:
    """Count the sensors whose name holds a text in letters of either case."""
    return session.scalar(sa.select(sa.func.count(Sensor.name)).where(*_holding(text))) or 0


def _holding(text: str) -> list[sa.ColumnElement[bool]]:
    """Keep to names that hold a text; every name holds nothing."""
    return [Sensor.name.icontains(text, autoescape=True)] if text else []
