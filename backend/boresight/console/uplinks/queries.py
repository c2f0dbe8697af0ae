"""Queries on uplink records, packages and table definitions."""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa

from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ONBOARD_STATES, ParameterSet, Promotion
from boresight.console.uplinks.tables import TableDefinition, Uplink
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Session

# What is said of a sensor's board, with its level: of all that its sets tell, the first of these.
BOARD_WORDS = {
    "MISMATCH": "critical",
    "DIFFERS": "caution",  # a set is active that is not the baseline
    "VERIFIED": "standby",
    "LOADED": "standby",
    "SENT": "standby",
    "THE SAME": "normal",
    "UNKNOWN": "caution",
    "NOT SENT": "off",
}
#: As `Uplink.is_step`.
IS_STEP = Uplink.leaves_state.is_(None)
#: After these nothing is known any more of the C_SD that is on board with a set.
FORGETS_C_SD = ("SENT", "MISMATCH", "UNKNOWN")


def list_records_until(session: Session, sensor_id: int, time_utc: str) -> Sequence[tuple[ParameterSet, Uplink]]:
    """Return each of a sensor's sets with its newest record of a state at a time."""
    newest = (
        sa.select(sa.func.max(Uplink.id))
        .join(ParameterSet)
        .where(ParameterSet.sensor_id == sensor_id, Uplink.recorded_utc <= time_utc, IS_STEP)
        .group_by(Uplink.parameter_set_id)
    )
    query = sa.select(ParameterSet, Uplink).join(Uplink, Uplink.parameter_set_id == ParameterSet.id)
    rows = session.execute(query.where(Uplink.id.in_(newest)).order_by(Uplink.id))
    return [(parameter_set, uplink) for parameter_set, uplink in rows]


def find_board_place() -> sa.ScalarSelect[int]:
    """Return the expression of the place in `BOARD_WORDS` of what is known of a sensor's board."""
    places = {word: place for place, word in enumerate(BOARD_WORDS)}
    is_baseline = ParameterSet.ground_state == "BASELINE"
    active = sa.case((is_baseline, places["THE SAME"]), else_=places["DIFFERS"])
    recorded = [(ParameterSet.onboard_state == state, places[state]) for state in ONBOARD_STATES if state in places]
    place = sa.case((ParameterSet.onboard_state == "ACTIVE", active), *recorded)
    query = sa.select(sa.func.coalesce(sa.func.min(place), places["NOT SENT"]))
    return query.where(ParameterSet.sensor_id == Sensor.id).correlate(Sensor).scalar_subquery()


def find_newest_record(session: Session, parameter_set_id: int, onboard_state: str | None = None) -> Uplink | None:
    """Return the newest record of a state of a set, of all or of one."""
    query = sa.select(Uplink).where(Uplink.parameter_set_id == parameter_set_id, IS_STEP)
    query = query.order_by(Uplink.id.desc()).limit(1)
    return session.scalar(query if onboard_state is None else query.where(Uplink.onboard_state == onboard_state))


def find_newest_compared(session: Session, parameter_set_id: int, method: str, after_id: int) -> Uplink | None:
    """Return the newest of a set's records after one that rests on a comparison by a method."""
    query = sa.select(Uplink).where(Uplink.parameter_set_id == parameter_set_id, Uplink.method == method)
    return session.scalar(query.where(Uplink.id > after_id).order_by(Uplink.id.desc()).limit(1))


def find_c_sd_record(session: Session, row: ParameterSet) -> Uplink | None:
    """Return the newest of a set's records that tells of its update of C_SD and still holds.

    It holds until the set is sent again, is not known to be on board, or the update of another set is loaded.
    """
    of_set = Uplink.parameter_set_id == row.id
    forgotten = sa.and_(of_set, IS_STEP, Uplink.onboard_state.in_(FORGETS_C_SD))
    replaced = sa.and_(~of_set, Uplink.c_sd == "LOADED")
    since = sa.select(sa.func.coalesce(sa.func.max(Uplink.id), 0)).join(ParameterSet)
    since = since.where(ParameterSet.sensor_id == row.sensor_id, sa.or_(forgotten, replaced))
    query = sa.select(Uplink).where(of_set, Uplink.c_sd.is_not(None), Uplink.id > since.scalar_subquery())
    return session.scalar(query.order_by(Uplink.id.desc()).limit(1))


def find_later_c_sd(session: Session, row: ParameterSet) -> ParameterSet | None:
    """Return the set whose update of C_SD was loaded last, where that set is newer than this one."""
    query = sa.select(ParameterSet).join(Uplink, Uplink.parameter_set_id == ParameterSet.id)
    query = query.where(ParameterSet.sensor_id == row.sensor_id, Uplink.c_sd == "LOADED")
    last = session.scalar(query.order_by(Uplink.id.desc()).limit(1))
    return last if last is not None and last.id > row.id else None


def list_other_sets(session: Session, row: ParameterSet) -> Sequence[ParameterSet]:
    """Return the other sets of a set's sensor that were ever baseline and so may be on board, newest first."""
    query = sa.select(ParameterSet).where(ParameterSet.sensor_id == row.sensor_id, ParameterSet.id != row.id)
    return session.scalars(
        query.where(ParameterSet.baseline_from_utc.is_not(None)).order_by(ParameterSet.id.desc())
    ).all()


def find_baseline_before(session: Session, row: ParameterSet) -> ParameterSet | None:
    """Return the set that was a sensor's baseline last, apart from this one."""
    query = sa.select(ParameterSet).join(Promotion, Promotion.parameter_set_id == ParameterSet.id)
    query = query.where(Promotion.sensor_id == row.sensor_id, Promotion.parameter_set_id != row.id)
    return session.scalar(query.order_by(Promotion.at_utc.desc(), Promotion.id.desc()).limit(1))


def find_set(session: Session, name: str) -> ParameterSet | None:
    """Return the set of a name."""
    return session.scalar(sa.select(ParameterSet).where(ParameterSet.name == name))


def find_definition_in_force(session: Session, sensor_id: int) -> TableDefinition | None:
    """Return a sensor's newest definition."""
    return next(iter(list_definitions(session, sensor_id, limit=1)), None)


def list_definitions(
    session: Session, sensor_id: int, limit: int | None = None, *, until: int | None = None
) -> Sequence[TableDefinition]:
    """Return a sensor's definitions, newest first; at most `limit`, from the version `until` back."""
    query = sa.select(TableDefinition).where(TableDefinition.sensor_id == sensor_id)
    if until is not None:
        query = query.where(TableDefinition.number <= until)
    return session.scalars(query.order_by(TableDefinition.number.desc()).limit(limit)).all()


def list_package_records(session: Session, package_ids: Sequence[int], action: str) -> Sequence[AuditRecord]:
    """Return the audit records of an action on packages, newest first."""
    objects = [f"packages/{number}" for number in package_ids]
    query = sa.select(AuditRecord).where(AuditRecord.object.in_(objects), AuditRecord.action == action)
    return session.scalars(query.order_by(AuditRecord.id.desc())).all()
