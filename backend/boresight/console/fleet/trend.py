"""A sensor over the mission: what each calibration found, at the time of its data; baselines and records on board.

A calibration stands at the middle of its telemetry, not at the time of its run: data of March that are calibrated in May
tell of March. Where the telemetry has no times, it stands at its upload and says so, and no slope is fitted through it.

What may be tested against what (`console.fleet.drift`) is decided here, a reason for each that is left out:

- the camera model is the baseline's; parameters of another model have another meaning;
- the parameters that were held fixed have the values that the baseline has, or the others would be of another problem;
- only one of several calibrations of the same data counts, because two looks at the same stars are one measurement: of those
  whose data overlap in time the newest data, then the batch, then the newest run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.console.fleet import queries as rows
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.transitions import get_sensor
from boresight.console.uplinks.tables import Uplink
from boresight.platform.db.sessions import Session, utc_text

SAME_VALUE = 1e-6  # of a typical sigma: what was held fixed there and here is the same number
BEFORE_TRENDS = "its summary has no covariance: it is from an older version; clone it and run it again"


@dataclass(frozen=True)
class TrendPoint:
    """One calibration, at the time of its data.

    `camera_model`, `names`, `parameters`, `covariance`: What was estimated: `names` (k,) with `covariance` (k, k) as it
    is used; `parameters` are all.
    """

    run_id: int
    label: str
    method: str
    telemetry_set_id: int
    telemetry: str
    begins_utc: str
    at_utc: str
    ends_utc: str
    timed: bool
    temperature_c: float | None
    camera_model: str
    names: tuple[str, ...]
    parameters: Mapping[str, float | None]
    covariance: FloatArray
    stars: int
    rms_arc_rad: float | None
    left_out: str
    said: str

    @property
    def sigma(self) -> dict[str, float]:
        """One sigma of each estimated parameter, SI."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def overlaps(self, other: TrendPoint) -> bool:
        """Whether both have data of one time, or the same data."""
        same = self.telemetry_set_id == other.telemetry_set_id
        return same or (
            self.timed and other.timed and self.begins_utc <= other.ends_utc and other.begins_utc <= self.ends_utc
        )


@dataclass(frozen=True)
class BaselinePeriod:
    """A set was the baseline from a time, until another."""

    set_id: int
    name: str
    from_utc: str
    to_utc: str | None
    measured: bool
    parameters: Mapping[str, float]
    sigma: Mapping[str, float | None]


@dataclass(frozen=True)
class OnBoardRecord:
    """Something was recorded on board."""

    at_utc: str
    state: str
    set_id: int
    name: str


@dataclass(frozen=True)
class Trend:
    """A sensor over the mission; `points` by the time of their data, those of other camera models under `others`."""

    sensor: Sensor
    baseline: ParameterSet | None
    camera_model: str
    points: Sequence[TrendPoint]
    others: Sequence[TrendPoint]
    periods: Sequence[BaselinePeriod]
    marks: Sequence[OnBoardRecord]
    telemetry: Mapping[int, TelemetrySet]

    @property
    def independent(self) -> list[TrendPoint]:
        """The calibrations that count, by the time of their data."""
        return [point for point in self.points if not point.left_out]

    def of_run(self, run_id: int | None) -> TrendPoint | None:
        """Return the calibration of a run."""
        return next((point for point in (*self.points, *self.others) if point.run_id == run_id), None)


def read_trend(session: Session, sensor_id: int) -> Trend:
    """Gather a sensor over the mission."""
    return read_trends(session, [get_sensor(session, sensor_id)])[sensor_id]


def read_trends(session: Session, sensors: Sequence[Sensor]) -> dict[int, Trend]:
    """Gather some sensors over the mission, in as many queries as for one."""
    ids = [sensor.id for sensor in sensors]
    finished, telemetry = rows.finished(session, ids), rows.telemetry(session, ids)
    promoted, records = rows.baselines_over_time(session, ids), rows.records(session, ids)
    return {
        sensor.id: _trend(
            sensor,
            promoted[sensor.id],
            finished[sensor.id],
            telemetry[sensor.id],
            _list_onboard_records(records[sensor.id]),
        )
        for sensor in sensors
    }


def _trend(
    sensor: Sensor,
    promoted: Sequence[tuple[Promotion, ParameterSet]],
    finished: Sequence[Any],
    telemetry: Mapping[int, TelemetrySet],
    marks: Sequence[OnBoardRecord],
) -> Trend:
    """Judge which calibrations of a sensor count, and put them in order."""
    baseline = promoted[-1][1] if promoted else None
    model = str((baseline.document if baseline else sensor.document)["camera_model"])
    found = [
        _point(run, telemetry[run.telemetry_set_id])
        for run in finished
        if (run.summary or {}).get("status") is not None
    ]
    judged = [_comparable(point, sensor, baseline) for point in found if point.camera_model == model]
    return Trend(
        sensor=sensor,
        baseline=baseline,
        camera_model=model,
        points=sorted(_counted_once(judged), key=_place),
        others=sorted((point for point in found if point.camera_model not in {model, ""}), key=_place),
        periods=list(_periods([(promotion.at_utc, row) for promotion, row in promoted])),
        marks=marks,
        telemetry=telemetry,
    )


def _list_onboard_records(records: Sequence[tuple[Uplink, ParameterSet]]) -> list[OnBoardRecord]:
    """Say what was recorded on board."""
    return [OnBoardRecord(record.recorded_utc, record.onboard_state, row.id, row.name) for record, row in records]


def get_time_span(row: TelemetrySet) -> tuple[str, str, bool]:
    """Return first and last time of a telemetry set, and whether they are its own and not the upload's."""
    time = row.quality.get("time")
    if not time:
        return row.uploaded_utc, row.uploaded_utc, False
    begins, ends = (utc_text(datetime.fromisoformat(time[key])) for key in ("start_utc", "end_utc"))
    return begins, ends, True


def _point(run: Any, data: TelemetrySet) -> TrendPoint:
    """Read a run's entry."""
    begins, ends, timed = get_time_span(data)
    entry, summary = run.summary.get("trend") or {}, run.summary
    warmth = data.quality.get("temperature_c")
    return TrendPoint(
        run_id=run.id,
        label=run.label,
        method=run.method,
        telemetry_set_id=data.id,
        telemetry=data.name,
        begins_utc=begins,
        at_utc=middle(begins, ends),
        ends_utc=ends,
        timed=timed,
        temperature_c=None if not warmth else (warmth["smallest"] + warmth["largest"]) / 2,
        camera_model=entry.get("camera_model") or "",
        names=tuple(entry.get("names") or ()),
        parameters=entry.get("parameters") or {},
        covariance=np.array(entry.get("covariance") or np.zeros((0, 0)), dtype=np.float64),
        stars=summary.get("stars") or 0,
        rms_arc_rad=summary.get("rms_final_arc_rad"),
        left_out=BEFORE_TRENDS if not entry else entry.get("left_out") or "",
        said=entry.get("said") or "",
    )


def middle(begins_utc: str, ends_utc: str) -> str:
    """Return the time halfway between two."""
    begins, ends = datetime.fromisoformat(begins_utc), datetime.fromisoformat(ends_utc)
    return utc_text(begins + timedelta(seconds=(ends - begins).total_seconds() / 2))


def _place(point: TrendPoint) -> tuple[str, int]:
    return point.at_utc, point.run_id


def _comparable(point: TrendPoint, sensor: Sensor, baseline: ParameterSet | None) -> TrendPoint:
    """Leave out what was estimated with other numbers held fixed than the baseline has."""
    if point.left_out or baseline is None:
        return point
    typical, held = sensor.document["typical_sigma"], baseline.document["parameters"]
    known = set(baseline.document["covariance"]["names"])
    odd = [name for name in sorted(known.symmetric_difference(point.names)) if not _same(point, held, typical, name)]
    if not odd:
        return point
    return replace(point, left_out=f"it has {', '.join(odd)} free or held otherwise than the baseline has")


def _same(point: TrendPoint, held: Mapping[str, float], typical: Mapping[str, float], name: str) -> bool:
    """Whether a parameter that only one of the two estimated has the same value in both."""
    value = point.parameters.get(name)
    return name not in point.names and value is not None and abs(value - held[name]) <= SAME_VALUE * typical[name]


def _counted_once(points: Sequence[TrendPoint]) -> Iterator[TrendPoint]:
    """Yield the calibrations, all but one of those whose data overlap left out."""
    counted: list[TrendPoint] = []
    for point in sorted(points, key=lambda one: (one.ends_utc, one.method == "batch", one.run_id), reverse=True):
        twin = next((other for other in counted if point.overlaps(other)), None)
        if not point.left_out and twin is not None:
            yield replace(point, left_out=f"its data overlap those of run {twin.run_id}, which is counted")
            continue
        if not point.left_out:
            counted.append(point)
        yield point


def _periods(promoted: Sequence[tuple[str, ParameterSet]]) -> Iterator[BaselinePeriod]:
    """Yield the baselines with their times."""
    ends = [*(at_utc for at_utc, _ in promoted[1:]), None] if promoted else []
    for (at_utc, row), to_utc in zip(promoted, ends, strict=True):
        document = row.document
        yield BaselinePeriod(
            row.id,
            row.name,
            at_utc,
            to_utc,
            row.run_id is not None,
            document["parameters"],
            document.get("sigma") or {},
        )
