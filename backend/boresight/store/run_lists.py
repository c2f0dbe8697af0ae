"""Reading many runs: pages of the list, counts, and what past runs tell about the next."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import sqlalchemy as sa

from boresight.store.sessions import Session
from boresight.store.tables import Run


def page_of_runs(session: Session, *, where: Mapping[str, Any], before_id: int | None, limit: int | None) -> list[Run]:
    """Return up to `limit` runs, newest first, whose columns equal (or, given several values, are one of) `where`.

    Their sensors' documents are read when they are asked for.
    """
    query = sa.select(Run).options(sa.orm.defer(Run.sensor_document)).order_by(Run.id.desc()).limit(limit)
    for name, value in where.items():
        column = getattr(Run, name)
        query = query.where(column == value if isinstance(value, str | int) else column.in_(value))
    return list(session.scalars(query if before_id is None else query.where(Run.id < before_id)))


def runs_of_set(session: Session, telemetry_set_id: int, limit: int) -> tuple[list[Run], int]:
    """Return the newest runs that fitted or validated with a telemetry set, and how many there are."""
    uses = sa.or_(Run.telemetry_set_id == telemetry_set_id, Run.validation_set_id == telemetry_set_id)
    newest = list(session.scalars(sa.select(Run).where(uses).order_by(Run.id.desc()).limit(limit)))
    return newest, session.scalar(sa.select(sa.func.count()).select_from(Run).where(uses)) or 0


def newest_finished(session: Session, sensor_id: int, limit: int) -> list[Run]:
    """Return a sensor's newest runs that succeeded, those with a validation set before all others."""
    query = sa.select(Run).where(Run.sensor_id == sensor_id, Run.state == "SUCCEEDED")
    return list(session.scalars(query.order_by(Run.validation_set_id.is_(None), Run.id.desc()).limit(limit)))


def count_queued_before(session: Session, run_id: int) -> int:
    """Count the runs that wait longer than one."""
    query = sa.select(sa.func.count()).select_from(Run).where(Run.state == "QUEUED", Run.id < run_id)
    return session.scalar(query) or 0


def neighbours(session: Session, run_id: int) -> tuple[int | None, int | None]:
    """Return the numbers of the runs before and after one, None at an end."""
    before = session.scalar(sa.select(sa.func.max(Run.id)).where(Run.id < run_id))
    return before, session.scalar(sa.select(sa.func.min(Run.id)).where(Run.id > run_id))


def count_by_state(session: Session) -> dict[str, int]:
    """Count the runs of each state that has any."""
    rows = session.execute(sa.select(Run.state, sa.func.count()).group_by(Run.state))
    return {row[0]: row[1] for row in rows}


def recent_runs(session: Session, method: str, limit: int) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return settings and summary of the newest runs of a method that succeeded."""
    query = sa.select(Run.settings, Run.summary).where(Run.state == "SUCCEEDED", Run.method == method)
    newest = session.execute(query.where(Run.summary.is_not(None)).order_by(Run.id.desc()).limit(limit))
    return [(settings, summary) for settings, summary in newest if summary]


def sensors_of(session: Session, run_ids: Collection[int]) -> list[int]:
    """Return the sensors that some runs are of, each once."""
    return list(session.scalars(sa.select(Run.sensor_id).where(Run.id.in_(run_ids)).distinct().order_by(Run.sensor_id)))
