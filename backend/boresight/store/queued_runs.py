"""What is to be computed: the runs that nobody holds with what decides how long each takes, and all that a claimed one needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import aliased

from boresight.store.sessions import Session
from boresight.store.tables import Run, TelemetrySet


@dataclass(frozen=True)
class Waiting:
    """A run that nobody holds, with what decides how long it will take."""

    run_id: int
    attempt: int
    method: str
    settings: Mapping[str, Any]
    frames: int
    stars: int


@dataclass(frozen=True)
class Claimed:
    """A run that is now ours: all that its computation needs."""

    run_id: int
    attempt: int
    settings: Mapping[str, Any]
    sensor_document: Mapping[str, Any]
    table_sha256: str
    validation_sha256: str | None


def waiting_runs(session: Session, limit: int) -> list[Waiting]:
    """Return the QUEUED runs, oldest first."""
    query = (
        sa.select(Run.id, Run.attempt, Run.method, Run.settings, TelemetrySet.frames, TelemetrySet.stars)
        .join(TelemetrySet, TelemetrySet.id == Run.telemetry_set_id)
        .where(Run.state == "QUEUED")
        .order_by(Run.id)
        .limit(limit)
    )
    return [Waiting(*row) for row in session.execute(query)]


def claimed_runs(session: Session, run_ids: Sequence[int]) -> list[Claimed]:
    """Read what the computation of claimed runs needs, in the order of their ids."""
    validation = aliased(TelemetrySet)
    query = (
        sa.select(
            Run.id,
            Run.attempt,
            Run.settings,
            Run.sensor_document,
            TelemetrySet.table_sha256,
            validation.table_sha256,
        )
        .join(TelemetrySet, TelemetrySet.id == Run.telemetry_set_id)
        .outerjoin(validation, validation.id == Run.validation_set_id)
        .where(Run.id.in_(run_ids))
        .order_by(Run.id)
    )
    return [Claimed(*row) for row in session.execute(query)]
