"""Queries on telemetry sets."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import sqlalchemy as sa

from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.telemetry.tables import ImportProfile, TelemetrySet
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session


def find_set_with_bytes(session: Session, sensor_id: int, original_sha256: str) -> TelemetrySet | None:
    """Return the sensor's set with this content."""
    query = sa.select(TelemetrySet).where(TelemetrySet.sensor_id == sensor_id)
    return session.scalar(query.where(TelemetrySet.original_sha256 == original_sha256))


def find_set_named(session: Session, sensor_id: int, name: str) -> TelemetrySet | None:
    """Return the oldest set of a sensor with a name, an archived one too."""
    query = sa.select(TelemetrySet).where(TelemetrySet.sensor_id == sensor_id, TelemetrySet.name == name)
    return session.scalar(query.order_by(TelemetrySet.id).limit(1))


def find_set_of_table(session: Session, sensor_id: int, table_sha256: str) -> TelemetrySet | None:
    """Return the oldest set of a sensor whose runs work on a table."""
    query = sa.select(TelemetrySet).where(
        TelemetrySet.sensor_id == sensor_id, TelemetrySet.table_sha256 == table_sha256
    )
    return session.scalar(query.order_by(TelemetrySet.id).limit(1))


def read_sensor_documents(session: Session) -> list[tuple[int, dict[str, Any]]]:
    """Return number and file of every sensor."""
    return [(row[0], row[1]) for row in session.execute(sa.select(Sensor.id, Sensor.document).order_by(Sensor.id))]


def read_measured_baselines(session: Session) -> dict[int, dict[str, Any]]:
    """Return the baselines that a run estimated, by the number of their sensor."""
    query = sa.select(ParameterSet.sensor_id, ParameterSet.document)
    query = query.where(ParameterSet.ground_state == "BASELINE", ParameterSet.run_id.is_not(None))
    return {row[0]: row[1] for row in session.execute(query)}


def read_heads(session: Session, sensor_ids: Collection[int], newest: int, set_ids: Collection[int]) -> list[Any]:
    """Return id, sensor_id, purpose, name and frames of sensors' sets in use, newest first."""
    row = TelemetrySet
    age = sa.func.row_number().over(partition_by=(row.sensor_id, row.purpose), order_by=row.id.desc()).label("age")
    of_these = sa.select(row.id, row.sensor_id, row.purpose, row.name, row.frames, age)
    aged = of_these.where(among(row.sensor_id, sensor_ids), row.archived_utc.is_(None)).subquery()
    wanted = sa.or_(aged.c.age <= newest, among(aged.c.id, set_ids))
    return list(session.execute(sa.select(aged).where(wanted).order_by(aged.c.id.desc())))


def read_names(session: Session, set_ids: Collection[int] | None) -> dict[int, str]:
    """Return the names of sets by their numbers; of all where None is given."""
    query = sa.select(TelemetrySet.id, TelemetrySet.name)
    if set_ids is not None:
        query = query.where(among(TelemetrySet.id, set_ids))
    return {row[0]: row[1] for row in session.execute(query)}


def find_newest_profile(session: Session, name: str) -> ImportProfile | None:
    """Return the newest version of a mapping profile's name, archived or not."""
    query = sa.select(ImportProfile).where(ImportProfile.name == name)
    return session.scalar(query.order_by(ImportProfile.number.desc()).limit(1))


def list_profiles_in_use(session: Session) -> Sequence[ImportProfile]:
    """Return the newest version of every mapping profile that is not archived, by name."""
    row = ImportProfile
    newest = sa.select(sa.func.max(row.id)).where(row.archived_utc.is_(None)).group_by(row.name)
    return session.scalars(sa.select(row).where(row.id.in_(newest)).order_by(row.name)).all()
