"""Queries on parameter sets and on when each was baseline."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import sqlalchemy as sa

from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session


def read_next_number(session: Session, sensor_id: int) -> int:
    """Return the number that the sensor's next set gets; the first is 0."""
    highest = session.scalar(sa.select(sa.func.max(ParameterSet.number)).where(ParameterSet.sensor_id == sensor_id))
    return 0 if highest is None else highest + 1


def find_set_of_run(session: Session, run_id: int) -> ParameterSet | None:
    """Return the set that was made from a run."""
    return session.scalar(sa.select(ParameterSet).where(ParameterSet.run_id == run_id))


def list_runs_with_sets(session: Session, run_ids: Collection[int]) -> set[int]:
    """Return which of some runs a set was made from."""
    return set(session.scalars(sa.select(ParameterSet.run_id).where(among(ParameterSet.run_id, run_ids))))


def read_heads(session: Session, set_ids: Collection[int]) -> dict[int, Any]:
    """Return name and sensor_id of some sets, by id."""
    query = sa.select(ParameterSet.id, ParameterSet.name, ParameterSet.sensor_id)
    return {row.id: row for row in session.execute(query.where(ParameterSet.id.in_(set_ids)))}


def find_baseline(session: Session, sensor_id: int) -> ParameterSet | None:
    """Return the sensor's baseline."""
    query = sa.select(ParameterSet).where(ParameterSet.sensor_id == sensor_id)
    return session.scalar(query.where(ParameterSet.ground_state == "BASELINE"))


def find_other_with_document(session: Session, row: ParameterSet, sha256: str) -> ParameterSet | None:
    """Return the newest other set of a set's sensor whose document has this hash."""
    query = sa.select(ParameterSet).where(ParameterSet.sensor_id == row.sensor_id, ParameterSet.sha256 == sha256)
    return session.scalar(query.where(ParameterSet.id != row.id).order_by(ParameterSet.id.desc()).limit(1))


def find_active_set(session: Session, sensor_id: int) -> ParameterSet | None:
    """Return the set that was read back as active on board."""
    query = sa.select(ParameterSet).where(ParameterSet.sensor_id == sensor_id)
    return session.scalar(query.where(ParameterSet.onboard_state == "ACTIVE"))


def list_promotions(session: Session, sensor_id: int) -> Sequence[Promotion]:
    """Return every promotion of a sensor, newest first."""
    query = sa.select(Promotion).where(Promotion.sensor_id == sensor_id)
    return session.scalars(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc())).all()


def find_baseline_at(session: Session, sensor_id: int, time_utc: str) -> ParameterSet | None:
    """Return the sensor's baseline at a time."""
    query = sa.select(ParameterSet).join(Promotion, Promotion.parameter_set_id == ParameterSet.id)
    query = query.where(Promotion.sensor_id == sensor_id, Promotion.at_utc <= time_utc)
    return session.scalar(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc()).limit(1))


def read_newest_approved(session: Session, sensor_ids: Collection[int]) -> dict[int, int]:
    """Return the number of the newest approved set, which awaits promotion, of each of some sensors that has any, by sensor."""
    query = sa.select(ParameterSet.sensor_id, sa.func.max(ParameterSet.id))
    query = query.where(ParameterSet.ground_state == "APPROVED", among(ParameterSet.sensor_id, sensor_ids))
    return {row[0]: row[1] for row in session.execute(query.group_by(ParameterSet.sensor_id))}


def list_sets_in(session: Session, sensor_ids: Collection[int], ground_states: Collection[str]) -> list[ParameterSet]:
    """Return the sets of sensors that were made from runs and are in one of these states or active on board, newest first."""
    trusted = sa.or_(ParameterSet.ground_state.in_(ground_states), ParameterSet.onboard_state == "ACTIVE")
    query = sa.select(ParameterSet).where(
        ParameterSet.sensor_id.in_(sensor_ids), ParameterSet.run_id.is_not(None), trusted
    )
    return list(session.scalars(query.order_by(ParameterSet.id.desc())))
