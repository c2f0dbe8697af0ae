"""Queries on campaigns, a fixed number of statements whatever their size; of a sensor's rows in one the newest counts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from boresight.console.campaigns.tables import Campaign, CampaignRun
from boresight.console.fleet.tables import Sensor
from boresight.console.runs.queries import Line, request_cancels, write_events
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.audit import seals
from boresight.platform.db.declared import Base
from boresight.platform.db.documents import among
from boresight.platform.db.sessions import Session, utc_now
from boresight.verdicts.verdict import RunSummary, parse_run_summary


@dataclass(frozen=True)
class MemberStatus:
    """The status of a sensor in a campaign; values that its run lacks, or all without a run, are None."""

    id: int
    sensor_id: int
    sensor: str
    run_id: int | None
    refusal: str | None
    telemetry_set_id: int | None
    validation_set_id: int | None
    state: str | None
    reason: str | None
    summary: RunSummary


@dataclass(frozen=True)
class Counted:
    """How many sensors of a campaign have a run in each state, None for no run; and the number of its newest launch."""

    by_state: Mapping[str | None, int]
    newest_id: int


def select_newest_members() -> sa.Select[Any]:
    """Select the row that counts of each sensor of each campaign."""
    return sa.select(sa.func.max(CampaignRun.id)).group_by(CampaignRun.campaign_id, CampaignRun.sensor_id)


def add_runs(session: Session, values: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    """Insert many runs as QUEUED, one a sensor, with the first line of each one's log; return their ids by sensor."""
    now = utc_now()
    fixed = {"state": "QUEUED", "attempt": 0, "cancel_requested": 0, "launched_utc": now}
    added = _insert(session, Run, [{**one, **fixed} for one in values], Run.id, Run.sensor_id)
    write_events(session, [(run_id, 0, Line.moved("QUEUED")) for run_id in sorted(run_id for run_id, _ in added)])
    return {sensor_id: run_id for run_id, sensor_id in added}


def add_members(session: Session, values: Sequence[Mapping[str, Any]]) -> None:
    """Insert many sensors of a campaign."""
    _insert(session, CampaignRun, values, CampaignRun.id)


def _insert(session: Session, model: type[Base], values: Sequence[Mapping[str, Any]], *returned: Any) -> list[Any]:
    """Insert many rows in few statements, note them for their seals, and return columns of each, its id first."""
    if not values:
        return []
    statement = sa.insert(model).execution_options(**seals.BULK)
    rows = list(session.execute(statement.returning(*returned), values))
    for row in rows:
        seals.note(session, model, row[0])
    return rows


def list_campaigns_of_run(session: Session, run_id: int) -> Sequence[Campaign]:
    """Return the campaigns that a run belongs to."""
    query = sa.select(Campaign).join(CampaignRun, CampaignRun.campaign_id == Campaign.id)
    return session.scalars(query.where(CampaignRun.run_id == run_id).order_by(Campaign.id)).all()


def count_members(session: Session, campaign_ids: Collection[int]) -> dict[int, Counted]:
    """Count the sensors of campaigns by the state of their runs."""
    counted = session.execute(
        sa.select(CampaignRun.campaign_id, Run.state, sa.func.count(), sa.func.max(CampaignRun.id))
        .outerjoin(Run, Run.id == CampaignRun.run_id)
        .where(CampaignRun.campaign_id.in_(campaign_ids), CampaignRun.id.in_(select_newest_members()))
        .group_by(CampaignRun.campaign_id, Run.state)
    )
    found = {campaign_id: Counted({}, 0) for campaign_id in campaign_ids}
    for campaign_id, state, count, newest_id in counted:
        before = found[campaign_id]
        found[campaign_id] = Counted({**before.by_state, state: count}, max(before.newest_id, newest_id))
    return found


def list_member_statuses(session: Session, campaign_id: int, ids: Collection[int] | None = None) -> list[MemberStatus]:
    """Return where the sensors of a campaign stand, or those of some rows, in the order of their rows."""
    some = sa.true() if ids is None else among(CampaignRun.id, ids)
    query = (
        sa.select(
            CampaignRun.id, CampaignRun.sensor_id, Sensor.name, CampaignRun.run_id, CampaignRun.refusal,
            Run.telemetry_set_id, Run.validation_set_id, Run.state, Run.reason, Run.summary,
        )
        .join(Sensor, Sensor.id == CampaignRun.sensor_id)
        .outerjoin(Run, Run.id == CampaignRun.run_id)
        .where(CampaignRun.campaign_id == campaign_id, some, CampaignRun.id.in_(select_newest_members()))
        .order_by(CampaignRun.id)
    )  # fmt: skip
    return [MemberStatus(*(*row[:-1], parse_run_summary(row.summary))) for row in session.execute(query)]


def cancel_all(session: Session, campaign_id: int, reason: str) -> list[tuple[int, str]]:
    """Ask every run of a campaign that has not ended to stop; return them with their new states."""
    of_campaign = sa.select(CampaignRun.run_id).where(CampaignRun.campaign_id == campaign_id)
    return request_cancels(session, Run.id.in_(of_campaign), reason)


def list_sets(session: Session, set_ids: Collection[int]) -> list[TelemetrySet]:
    """Return telemetry sets; while the caller holds them, the session finds each without a query."""
    return list(session.scalars(sa.select(TelemetrySet).where(among(TelemetrySet.id, set_ids))))


def read_newest_sets(session: Session, sensor_ids: Collection[int]) -> dict[tuple[int, str], int]:
    """Return the newest set in use of each of these sensors and purpose, by (sensor id, purpose)."""
    query = (
        sa.select(TelemetrySet.sensor_id, TelemetrySet.purpose, sa.func.max(TelemetrySet.id))
        .where(TelemetrySet.archived_utc.is_(None), among(TelemetrySet.sensor_id, sensor_ids))
        .group_by(TelemetrySet.sensor_id, TelemetrySet.purpose)
    )
    return {(sensor_id, purpose): newest for sensor_id, purpose, newest in session.execute(query)}
