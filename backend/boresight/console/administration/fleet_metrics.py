"""The metrics of the domain: what the fleet, the people's work and the machinery are like, read when Prometheus asks.

Each reading is a few statements, kept for some seconds however often is asked. Times are given as Unix times, so that their age is
`time() - x` in every expression and nothing here moves by itself. A label has few values: states and kinds are words of the
program, and of sensors there are `MOST`, those with the oldest baselines and the smallest p.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

import boresight
from boresight.console.administration import queries as rows
from boresight.console.alarms.tables import ALARM_KINDS, ALARM_LEVELS
from boresight.console.alignments import queries as alignment_rows
from boresight.console.backups import queries as backup_rows
from boresight.console.backups.service import find_schedule
from boresight.console.fleet import queries as fleet_rows
from boresight.console.fleet.status import STATUS_WORDS, get_drift_verdicts, list_sensor_statuses
from boresight.console.messages.tables import Message
from boresight.console.runs import service as runs
from boresight.console.runs.tables import RUN_STATES
from boresight.console.webhooks.tables import WebhookDelivery
from boresight.errors import BoresightError
from boresight.platform.db.sessions import Engine, Session, open_reading
from boresight.platform.jobs.worker_news import WorkerState

MOST = 100  # sensors that have series of their own
KEPT_S = 5.0
ALARM_STATES = ("unacknowledged", "acknowledged", "shelved")


@dataclass(frozen=True)
class Gauge:
    """A metric of the domain: its name without the prefix, its help, and its labels."""

    name: str
    help: str
    labels: tuple[str, ...] = ()


#: Every metric that is read from the store or the server when it is asked for.
GAUGES = {
    gauge.name: gauge
    for gauge in (
        Gauge("build_info", "1, with the version of Boresight.", ("version",)),
        Gauge("store_up", "1 where the store could be read for this scrape, else 0."),
        Gauge("sensors", "Sensors by the worst finding on each, as the overview shows it.", ("status",)),
        Gauge("sensors_without_baseline", "Sensors that have no baseline."),
        Gauge(
            "baseline_start_timestamp_seconds",
            "Unix time from which the baseline is in force; the oldest ones.",
            ("sensor",),
        ),
        Gauge(
            "drift_p_value",
            "Smallest p of the tests for drift of a sensor; the sensors with the smallest.",
            ("sensor",),
        ),
        Gauge("approvals_waiting", "Requests that wait for signatures."),
        Gauge(
            "approvals_oldest_timestamp_seconds", "Unix time since which the oldest of them waits; absent without any."
        ),
        Gauge("ingest_decisions_waiting", "Ingest decisions that wait for an answer."),
        Gauge("alarms", "Alarms that are not closed.", ("kind", "level", "state")),
        Gauge("runs", "Runs in the store by state.", ("state",)),
        Gauge(
            "queue_oldest_timestamp_seconds", "Unix time since which the oldest queued run waits; absent without any."
        ),
        Gauge("workers_connected", "1 while this server is connected to its scheduler, else 0."),
        Gauge("worker_threads", "Threads of the workers that this server knows."),
        Gauge("worker_tasks", "Tasks that this server gave to workers and that have not ended."),
        Gauge("backup_scheduled", "1 while a schedule for backups is in force, else 0."),
        Gauge(
            "backup_newest_timestamp_seconds",
            "Unix time of the store in the newest good backup; absent if there is none.",
        ),
        Gauge(
            "backup_tested_timestamp_seconds",
            "Unix time at which that one was last restored to verify it; absent without.",
        ),
        Gauge("webhook_deliveries", "Messages to webhooks that wait, or were given up.", ("state",)),
        Gauge("messages", "Messages to people that wait, or were given up.", ("state",)),
        Gauge("audit_intact", "0 once the verification found that the audit log was altered, else 1."),
    )
}

Values = Mapping[tuple[str, ...], float]


@dataclass(frozen=True)
class ServerParts:
    """What a server knows beside its store."""

    workers: Callable[[], WorkerState | None]
    broken: Callable[[], str]


@dataclass(eq=False)
class FleetMetrics(Collector):
    """The collector of the domain's metrics."""

    database: Engine
    server: ServerParts
    _kept: dict[str, Values] = field(default_factory=dict)
    _read_s: float = float("-inf")

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield every metric as it is now, or was some seconds ago."""
        found: dict[str, Values] = {"build_info": {(boresight.__version__,): 1.0}, **self._read_server()}
        try:
            found |= self._read_store_again()
            found["store_up"] = {(): 1.0}
        except (BoresightError, OSError):
            found["store_up"] = {(): 0.0}
        for name, values in found.items():
            gauge = GAUGES[name]
            family = GaugeMetricFamily(f"boresight_{name}", gauge.help, labels=gauge.labels)
            for labels, value in values.items():
                family.add_metric(list(labels), value)
            yield family

    def describe(self) -> list[Any]:
        """Describe nothing at registration: the store may not be migrated yet."""
        return []

    def _read_server(self) -> dict[str, Values]:
        state = self.server.workers() or WorkerState()
        return {
            "audit_intact": {(): float(not self.server.broken())},
            "workers_connected": {(): float(state.connected)},
            "worker_threads": {(): float(state.threads)},
            "worker_tasks": {(): float(state.tasks)},
        }

    def _read_store_again(self) -> dict[str, Values]:
        """Read the store; the states of runs each time, everything else once in some seconds."""
        with open_reading(self.database) as session:
            if time.monotonic() - self._read_s > KEPT_S:
                self._kept, self._read_s = read_store(session), time.monotonic()
            states = runs.count_by_state(session)
        return {**self._kept, "runs": {(state,): float(states.get(state, 0)) for state in RUN_STATES}}


def read_store(session: Session) -> dict[str, Values]:
    """Return the metrics that are read from the store, by name; the value of each by its labels."""
    statuses = [one.status for one in list_sensor_statuses(session)]
    waiting, since_utc = rows.read_open_approvals(session)
    of_alignments, asked_utc = alignment_rows.read_open_requests(session)
    oldest = (since_utc, asked_utc)
    alarms = rows.count_open_alarms(session)
    backup = backup_rows.find_newest(session, "SUCCEEDED")
    every = ((kind, level, state) for kind in ALARM_KINDS for level in ALARM_LEVELS for state in ALARM_STATES)
    return {
        "sensors": {(word,): float(statuses.count(word)) for word in STATUS_WORDS},
        "sensors_without_baseline": {(): float(rows.count_without_baseline(session))},
        "baseline_start_timestamp_seconds": _at(
            ((name,), at_utc) for name, at_utc in rows.list_oldest_baselines(session, MOST)
        ),
        "drift_p_value": _smallest_p(session),
        "approvals_waiting": {(): float(waiting + of_alignments)},
        "approvals_oldest_timestamp_seconds": _at([((), min(filter(None, oldest), default=None))]),
        "ingest_decisions_waiting": {(): float(rows.count_asked_decisions(session))},
        "alarms": {labels: float(alarms.get(labels, 0)) for labels in every},
        "queue_oldest_timestamp_seconds": _at([((), rows.read_queue(session))]),
        "backup_scheduled": {(): float(find_schedule(session) is not None)},
        "backup_newest_timestamp_seconds": _at([((), backup.started_utc if backup else None)]),
        "backup_tested_timestamp_seconds": _at([((), backup.tested_utc if backup else None)]),
        "webhook_deliveries": _by_state(rows.count_undelivered(session, WebhookDelivery)),
        "messages": _by_state(rows.count_undelivered(session, Message)),
    }


def _at(times: Iterable[tuple[tuple[str, ...], str | None]]) -> Values:
    """Return times of the store as Unix times, seconds; without those that there are not."""
    return {labels: datetime.fromisoformat(text).timestamp() for labels, text in times if text is not None}


def _by_state(counts: Mapping[str, int]) -> Values:
    return {(state,): float(count) for state, count in counts.items()}


def _smallest_p(session: Session) -> Values:
    """Return the smallest p of each sensor whose trend was judged; a scrape judges none again.

    A shift against a ground calibration is no drift, and has none.
    """
    heads = fleet_rows.list_sensor_heads(session)
    names = {head.id: head.name for head in heads}
    baselines, stamps = fleet_rows.list_baseline_heads(session), fleet_rows.read_trend_stamps(session)
    judged = get_drift_verdicts(session, heads, baselines, stamps, most=0)
    found = {}
    for sensor_id, verdict in judged.items():
        tests = (verdict.document["baseline_holds"], verdict.document["slope"])
        values = [float(test["p"]) for test in tests if test is not None and test["p"] is not None]
        if values and verdict.verdict != "GROUND SHIFT":
            found[(names[sensor_id],)] = min(values)
    return dict(sorted(found.items(), key=lambda one: one[1])[:MOST])
