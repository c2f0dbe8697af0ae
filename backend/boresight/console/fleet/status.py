"""The state of the fleet: the worst finding on every sensor, with its reason.

From worst to best: critical, serious, caution, normal, standby, off. Verdicts on drift take a whole trend and are
remembered until a run succeeds, another set becomes the baseline or the sensor's document changes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any
from weakref import WeakKeyDictionary

from boresight.calibration.calibration import to_plain
from boresight.console.alarms import queries as alarms_queries
from boresight.console.alarms.tables import Alarm
from boresight.console.fleet import queries
from boresight.console.fleet.tables import Sensor
from boresight.console.fleet.trend import GROUND_SHIFTED, document, judge_drift, read_trends
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs.tables import Run, parse_progress
from boresight.platform.db.sessions import Session, utc_now
from boresight.verdicts.verdict import WORD_OF_LEVEL, RunSummary, judge_result, parse_run_summary

TOGETHER = 16  # sensors whose runs are held in memory at once


@dataclass(frozen=True)
class DriftVerdict:
    """What `judge_drift` said: its verdict, its sentence, and the figures as JSON."""

    verdict: str
    sentence: str
    document: dict[str, Any]


#: By store and sensor: what a drift verdict rests on, and the verdict.
_known: WeakKeyDictionary[Any, dict[int, tuple[Any, DriftVerdict]]] = WeakKeyDictionary()


def get_drift_verdicts(
    session: Session,
    sensors: Sequence[Any],
    baselines: Mapping[int, Any],
    stamps: Mapping[int, Any],
    *,
    most: int | None = None,
) -> dict[int, DriftVerdict]:
    """Return whether some sensors drift, by id; verdicts that are not cached are computed, `TOGETHER` sensors at a time."""
    of_store = _known.setdefault(session.get_bind().engine.pool, {})  # an engine with options is another object
    rests_on = {
        sensor.id: (getattr(baselines.get(sensor.id), "id", None), sensor.version, stamps.get(sensor.id))
        for sensor in sensors
    }
    unknown = [sensor.id for sensor in sensors if of_store.get(sensor.id, (None,))[0] != rests_on[sensor.id]]
    judged = unknown if most is None else unknown[:most]
    for start in range(0, len(judged), TOGETHER):
        asked = queries.list_sensors(session, judged[start : start + TOGETHER])
        for sensor_id, trend in read_trends(session, asked).items():
            found = judge_drift(trend)
            said = DriftVerdict(found.verdict, found.sentence, to_plain(document(found)))
            of_store[sensor_id] = (rests_on[sensor_id], said)
    return {sensor.id: of_store[sensor.id][1] for sensor in sensors if sensor.id in of_store}


STATUS_WORDS = ("critical", "serious", "caution", "normal", "standby", "off")
WORSE_THAN_NORMAL = STATUS_WORDS[: STATUS_WORDS.index("normal")]
OLD_DAYS = 180.0  # a baseline older than this deserves a look
SECONDS_PER_DAY = 86400.0
MOST_JUDGED = 100  # ground calibrations that one call judges again: a fifth of a second


@dataclass(frozen=True)
class SensorTile:
    """What the overview shows of a sensor."""

    sensor: Sensor
    baseline: ParameterSet | None
    active: ParameterSet | None
    last_run: Run | None
    telemetry_sets: int
    days_since_calibration: float | None
    status: str
    sentence: str

    @property
    def summary(self) -> RunSummary:
        """What the newest run found."""
        return parse_run_summary(self.last_run.summary if self.last_run else None)

    @property
    def fraction(self) -> float | None:
        """How far the newest run is; None where it computes nothing."""
        is_computing = self.last_run is not None and self.last_run.state == "RUNNING"
        return parse_progress(self.last_run.progress).fraction if self.last_run and is_computing else None


@dataclass(frozen=True)
class SensorStatus:
    """The status of a sensor."""

    sensor_id: int
    name: str
    status: str
    sentence: str
    is_judged: bool = True
    has_telemetry: bool = False
    last_run: Any = None


@dataclass(frozen=True)
class SensorFacts:
    """What is known of one sensor; `baseline`, `last_run` and `onboard` are rows or their heads (`console.fleet.queries`)."""

    baseline: Any
    last_run: Any
    onboard: tuple[Any, ...]
    waiting: str | None
    telemetry_sets: int
    days: float | None
    drift: Alarm | None = None
    ground_shifted: bool | None = False  # None where its runs have not been read yet


def list_sensor_statuses(session: Session, sensor_ids: Collection[int] | None = None) -> list[SensorStatus]:
    """Return the status of every sensor of the fleet, or of some, by name; much cheaper than their tiles."""
    heads = queries.list_sensor_heads(session, sensor_ids)
    baselines, runs = queries.list_baseline_heads(session, sensor_ids), queries.list_last_run_heads(session, sensor_ids)
    onboard, counts = queries.list_onboard_heads(session, sensor_ids), queries.count_sets(session, sensor_ids)
    waiting, drifting = queries.read_waiting_approvals(session, sensor_ids), _list_drifting(session)
    known = {
        head.id: SensorFacts(
            baseline=baselines.get(head.id),
            last_run=runs.get(head.id),
            onboard=tuple(onboard.get(head.id, ())),
            waiting=waiting.get(head.id),
            telemetry_sets=counts.get(head.id, 0),
            days=count_days_since(baselines.get(head.id)),
            drift=drifting.get(head.id),
        )
        for head in heads
    }
    for sensor_id, shifted in _find_ground_shifts(session, heads, known):
        known[sensor_id] = replace(known[sensor_id], ground_shifted=shifted)
    return [
        SensorStatus(
            head.id,
            head.name,
            *_worst(one := known[head.id]),
            is_judged=one.ground_shifted is not None,
            has_telemetry=one.telemetry_sets > 0,
            last_run=one.last_run,
        )
        for head in heads
    ]


def list_fleet_tiles(session: Session, sensor_ids: Collection[int] | None = None) -> list[SensorTile]:
    """Return a tile for every sensor, or for some, by name."""
    return list_tiles(session, list_sensor_statuses(session, sensor_ids))


def list_tiles(session: Session, stand: Sequence[SensorStatus], *, documents: bool = True) -> list[SensorTile]:
    """Return the tiles of sensors with these statuses, in their order; `documents` loads those of sensors and baselines too."""
    ids = [one.sensor_id for one in stand]
    sensors = {sensor.id: sensor for sensor in queries.list_sensors(session, ids, documents=documents)}
    baselines, runs = queries.list_baselines(session, ids, documents=documents), queries.list_last_runs(session, ids)
    onboard, counts = queries.list_onboard_sets(session, ids), queries.count_sets(session, ids)
    return [
        SensorTile(
            sensor=sensors[one.sensor_id],
            baseline=baselines.get(one.sensor_id),
            active=next((row for row in onboard.get(one.sensor_id, ()) if row.onboard_state == "ACTIVE"), None),
            last_run=runs.get(one.sensor_id),
            telemetry_sets=counts.get(one.sensor_id, 0),
            days_since_calibration=count_days_since(baselines.get(one.sensor_id)),
            status=one.status,
            sentence=one.sentence,
        )
        for one in stand
    ]


def _is_on_the_ground(known: SensorFacts) -> bool:
    """Whether a sensor uses its ground calibration and has no worse finding that would hide a ground shift."""
    if known.baseline is None or known.baseline.run_id is not None:
        return False
    return not any(word in WORSE_THAN_NORMAL for word, _ in list_findings(known))


def _find_ground_shifts(
    session: Session, heads: Sequence[Any], known: Mapping[int, SensorFacts]
) -> Iterator[tuple[int, bool | None]]:
    """Yield whether each ground calibration has shifted; None beyond `MOST_JUDGED` that this call would have to judge again."""
    asked = [head for head in heads if _is_on_the_ground(known[head.id])]
    stamps = queries.read_trend_stamps(session, [head.id for head in asked])
    asked = [head for head in asked if head.id in stamps]
    baselines = {head.id: known[head.id].baseline for head in asked}
    judged = get_drift_verdicts(session, asked, baselines, stamps, most=MOST_JUDGED)
    for head in asked:
        found = judged.get(head.id)
        yield head.id, None if found is None else found.verdict == "GROUND SHIFT"


def _list_drifting(session: Session) -> dict[int | None, Alarm]:
    """Return the active drift alarms by sensor, without shelved ones."""
    found = [row for row in alarms_queries.list_open_alarms(session).values() if row.kind == "DRIFT" and row.active]
    return {row.sensor_id: row for row in found if not (row.shelved_until_utc or "") > utc_now()}


def _worst(known: SensorFacts) -> tuple[str, str]:
    """Return the worst finding, the first of equally bad ones."""
    return min(list_findings(known), key=lambda finding: STATUS_WORDS.index(finding[0]))


def count_days_since(baseline: Any) -> float | None:
    """Return the days since a set became baseline."""
    if baseline is None or baseline.baseline_from_utc is None:
        return None
    since = datetime.now(UTC) - datetime.fromisoformat(baseline.baseline_from_utc)
    return max(0.0, since.total_seconds() / SECONDS_PER_DAY)


def list_findings(known: SensorFacts) -> Iterator[tuple[str, str]]:
    """Yield every finding on a sensor as a status word and its sentence; there is always one."""
    yield from _onboard_findings(known)
    if known.drift is not None:
        yield known.drift.level, f"Drift detected: alarm {known.drift.id}."
    yield from _run_findings(known.last_run)
    if known.ground_shifted:
        yield "caution", GROUND_SHIFTED
    if known.waiting is not None:
        yield "caution", f"{known.waiting} is waiting for a signature."
    if known.baseline is None:
        yield "serious", "There is no baseline; register the sensor again."
    elif known.days is not None and known.days > OLD_DAYS:
        yield "caution", f"The baseline {known.baseline.name} is {known.days:.0f} days old; recalibrate."
    elif known.baseline.run_id is not None:
        yield "normal", f"{known.baseline.name} is the baseline."
    if known.telemetry_sets == 0:
        yield "off", "There is no telemetry yet; upload a set."
    elif known.last_run is None:
        yield "standby", "There is telemetry but no calibration yet; launch a run."


def _onboard_findings(known: SensorFacts) -> Iterator[tuple[str, str]]:
    for row in known.onboard:
        if row.onboard_state == "MISMATCH":
            yield "critical", f"The read-back of {row.name} does not match what was sent."
        elif known.baseline is not None and row.id != known.baseline.id:
            yield "caution", f"{row.name} is active on board, and the baseline is {known.baseline.name}."


def _run_findings(run: Any) -> Iterator[tuple[str, str]]:
    if run is None:
        return
    if run.state in {"FAILED", "LOST"}:
        yield "serious", f"Run {run.id} {run.state.lower()}: {run.reason or 'no cause was recorded'}"
    elif run.state == "SUCCEEDED":
        yield _result_finding(run.id, parse_run_summary(run.summary))
    elif run.state == "CANCELLED":
        yield "standby", f"Run {run.id} was cancelled."
    else:
        yield "standby", f"Run {run.id} is {run.state.lower()}."


def _result_finding(run_id: int, summary: RunSummary) -> tuple[str, str]:
    """Return the finding from a finished calibration; critical is reserved for what is on board."""
    level = judge_result(summary)
    # how it is known and what to do are on the run's page, and would make ten lines of a row
    found = summary.finding or summary.advice or "see its page"
    status, advice = summary.status or "converged", f"{found.rstrip('.')}."
    if level == "normal":
        return level, f"Run {run_id} converged."
    if status == "converged":
        return level, f"Run {run_id} {WORD_OF_LEVEL[level]}: {advice}"
    verb = "stopped at" if status == "max_iterations" else "ended"
    return "caution" if level == "caution" else "serious", f"Run {run_id} {verb} {status.replace('_', ' ')}: {advice}"
