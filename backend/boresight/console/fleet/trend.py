"""A sensor over the mission: what each calibration found, at the time of its data, and whether the sensor drifts.

What may be tested against what is decided here, a reason for each that is left out:

- the camera model is the baseline's; parameters of another model have another meaning;
- the parameters that were held fixed have the values that the baseline has, or the others would be of another problem;
- only one of several calibrations of the same data counts: the newest data, then the batch, then the newest run.

Only data since the baseline's own take part in the tests of `estimation.statistics.drift`, which share a false-alarm
rate of 0.1 % for each look: does the newest calibration agree with the baseline, and do all of them move with time,
once temperature has its part? A shift against a ground calibration, which is declared and not measured, is a `GROUND
SHIFT` and no drift.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.calibration import Values
from boresight.calibration.parameter_set import parse_parameter_set
from boresight.calibration.result import TrendEntry
from boresight.console.fleet import queries as rows
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.telemetry.tables import TelemetrySet, find_quality
from boresight.console.uplinks.tables import Uplink
from boresight.estimation.pass_forecast import FollowedPass, PassForecaster
from boresight.estimation.statistics import drift as tests
from boresight.estimation.statistics.drift import FALSE_ALARM_RATE, Epoch, RegressionLine
from boresight.platform.db.sessions import Session, utc_text
from boresight.verdicts import trend as documents
from boresight.verdicts.numbers import NARROW_SPACE, fixed, number, quantity
from boresight.verdicts.verdict import RunSummary, parse_run_summary

SAME_VALUE = 1e-6  # in typical sigmas: fixed parameters that differ by less are the same
BEFORE_TRENDS = "no covariance in its summary (made by an older version): clone the run and run it again"


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
        """The sigma of each estimated parameter, SI."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def counted(self) -> bool:
        """Whether the calibration takes part in the tests."""
        return not self.left_out

    def overlaps(self, other: TrendPoint) -> bool:
        """Whether the data of both overlap in time, or are the same."""
        same = self.telemetry_set_id == other.telemetry_set_id
        return same or (
            self.timed and other.timed and self.begins_utc <= other.ends_utc and other.begins_utc <= self.ends_utc
        )


@dataclass(frozen=True)
class Trend:
    """A sensor over the mission; `points` by the time of their data, those of other camera models under `others`.

    `failed`: numbers of the telemetry sets whose newest calibration failed.
    """

    sensor: Sensor
    baseline: ParameterSet | None
    camera_model: str
    points: Sequence[TrendPoint]
    others: Sequence[TrendPoint]
    periods: Sequence[documents.TrendBaseline]
    on_board: Sequence[documents.OnBoardMark]
    telemetry: Mapping[int, TelemetrySet]
    failed: Collection[int] = ()

    @property
    def independent(self) -> list[TrendPoint]:
        """The calibrations that count, by the time of their data."""
        return [point for point in self.points if not point.left_out]

    def find_run(self, run_id: int | None) -> TrendPoint | None:
        """Return the calibration of a run."""
        return next((point for point in (*self.points, *self.others) if point.run_id == run_id), None)


def read_trend(session: Session, sensor_id: int) -> Trend:
    """Read the trend of a sensor."""
    return read_trends(session, [session.get_known(Sensor, sensor_id)])[sensor_id]


def read_trends(session: Session, sensors: Sequence[Sensor]) -> dict[int, Trend]:
    """Read the trends of some sensors, in as many queries as for one."""
    ids = [sensor.id for sensor in sensors]
    finished, telemetry = rows.list_finished_runs(session, ids), rows.list_telemetry(session, ids)
    promoted, records = rows.list_baselines_over_time(session, ids), rows.list_records(session, ids)
    failed = rows.list_failed_sets(session, ids)
    return {
        sensor.id: _trend(
            sensor,
            promoted[sensor.id],
            finished[sensor.id],
            telemetry[sensor.id],
            [_on_board(one, row) for one, row in records[sensor.id]],
            {set_id for sensor_id, set_id in failed if sensor_id == sensor.id},
        )
        for sensor in sensors
    }


def _trend(
    sensor: Sensor,
    promoted: Sequence[tuple[Promotion, ParameterSet]],
    finished: Sequence[Any],
    telemetry: Mapping[int, TelemetrySet],
    on_board: Sequence[documents.OnBoardMark],
    failed: Collection[int],
) -> Trend:
    """Judge which calibrations of a sensor count, and put them in order."""
    baseline = promoted[-1][1] if promoted else None
    model = str((baseline.document if baseline else sensor.document)["camera_model"])
    found = [
        _point(run, summary, telemetry[run.telemetry_set_id])
        for run in finished
        if (summary := parse_run_summary(run.summary)).status is not None
    ]
    judged = [_comparable(point, sensor, baseline) for point in found if point.camera_model == model]
    return Trend(
        sensor=sensor,
        baseline=baseline,
        camera_model=model,
        points=sorted(_counted_once(judged), key=_order),
        others=sorted((point for point in found if point.camera_model not in {model, ""}), key=_order),
        periods=list(_periods([(promotion.at_utc, row) for promotion, row in promoted])),
        on_board=on_board,
        telemetry=telemetry,
        failed=failed,
    )


def get_time_span(row: TelemetrySet) -> tuple[str, str, bool]:
    """Return the first and last time of a telemetry set, and whether they come from its data and not from its upload."""
    time = find_quality(row.quality).time
    if time is None:
        return row.uploaded_utc, row.uploaded_utc, False
    begins, ends = (utc_text(datetime.fromisoformat(text)) for text in (time.start_utc, time.end_utc))
    return begins, ends, True


def _point(run: Any, summary: RunSummary, data: TelemetrySet) -> TrendPoint:
    begins, ends, timed = get_time_span(data)
    entry = summary.trend or TrendEntry(left_out=BEFORE_TRENDS)
    warmth = find_quality(data.quality).temperature_c
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
        temperature_c=None if warmth is None else (warmth.smallest + warmth.largest) / 2,
        camera_model=entry.camera_model,
        names=tuple(entry.names),
        parameters=entry.parameters,
        covariance=np.array(entry.covariance or np.zeros((0, 0)), dtype=np.float64),
        stars=summary.stars or 0,
        rms_arc_rad=summary.rms_final_arc_rad,
        left_out=entry.left_out or "",
        said=entry.said or "",
    )


def middle(begins_utc: str, ends_utc: str) -> str:
    """Return the time halfway between two."""
    begins, ends = datetime.fromisoformat(begins_utc), datetime.fromisoformat(ends_utc)
    return utc_text(begins + timedelta(seconds=(ends - begins).total_seconds() / 2))


def _order(point: TrendPoint) -> tuple[str, int]:
    return point.at_utc, point.run_id


def _comparable(point: TrendPoint, sensor: Sensor, baseline: ParameterSet | None) -> TrendPoint:
    """Exclude calibrations whose fixed parameters differ from the baseline's."""
    if point.left_out or baseline is None:
        return point
    typical, held = sensor.document["typical_sigma"], baseline.document["parameters"]
    known = set(baseline.document["covariance"]["names"])
    odd = [name for name in sorted(known.symmetric_difference(point.names)) if not _same(point, held, typical, name)]
    if not odd:
        return point
    return replace(point, left_out=f"its list of free parameters differs from the baseline: {', '.join(odd)}")


def _same(point: TrendPoint, held: Mapping[str, float], typical: Mapping[str, float], name: str) -> bool:
    """Whether a parameter that only one of the two estimated has the same value in both."""
    value = point.parameters.get(name)
    return name not in point.names and value is not None and abs(value - held[name]) <= SAME_VALUE * typical[name]


def _counted_once(points: Sequence[TrendPoint]) -> Iterator[TrendPoint]:
    """Yield the calibrations, only one of those whose data overlap."""
    counted: list[TrendPoint] = []
    for point in sorted(points, key=lambda one: (one.ends_utc, one.method == "batch", one.run_id), reverse=True):
        twin = next((other for other in counted if point.overlaps(other)), None)
        if not point.left_out and twin is not None:
            yield replace(point, left_out=f"its data overlap with run {twin.run_id}, which is used instead")
            continue
        if not point.left_out:
            counted.append(point)
        yield point


def _on_board(record: Uplink, row: ParameterSet) -> documents.OnBoardMark:
    return documents.OnBoardMark(
        at_utc=record.recorded_utc, state=record.onboard_state, parameter_set_id=row.id, name=row.name
    )


def _periods(promoted: Sequence[tuple[str, ParameterSet]]) -> Iterator[documents.TrendBaseline]:
    ends = [*(at_utc for at_utc, _ in promoted[1:]), None] if promoted else []
    for (at_utc, row), to_utc in zip(promoted, ends, strict=True):
        document = parse_parameter_set(row.document)
        yield documents.TrendBaseline(
            parameter_set_id=row.id,
            name=row.name,
            from_utc=at_utc,
            to_utc=to_utc,
            measured=row.run_id is not None,
            parameters=document.parameters,
            sigma=document.reliable_sigma,
        )


DAY_S = 86400.0
MOST_FOLLOWED = 60  # calibrations that forecast the newest
GROUND_SHIFTED = "The ground calibration is no longer valid: promote a calibration made on orbit."
EPOCH = "2000-01-01T12:00:00+00:00"  # days are counted from J2000, an arbitrary origin


@dataclass(frozen=True)
class DriftResult:
    """What the tests say.

    `names`: (k,) parameters that were tested. `difference`, `sigma`: (k,) newest minus baseline and one sigma of it,
    SI. `covariance`: (k, k) of the difference. `is_jump`: the newest is where neither the baseline nor the line through the
    calibrations since then has it.
    """

    verdict: str
    sentence: str
    names: tuple[str, ...] = ()
    newest: TrendPoint | None = None
    difference: FloatArray | None = None
    sigma: FloatArray | None = None
    covariance: FloatArray | None = None
    holds: tests.ChiSquareTest | None = None
    slope: tests.ChiSquareTest | None = None
    line: RegressionLine | None = None
    counted: int = 0
    is_jump: bool = False

    @property
    def largest(self) -> tuple[str, float] | None:
        """The parameter that moved most in its own sigma, and by how many."""
        if self.difference is None or self.sigma is None:
            return None
        worth = self.difference / self.sigma
        most = int(np.argmax(np.abs(worth)))
        return self.names[most], float(worth[most])


def judge_drift(trend: Trend, alpha: float = FALSE_ALARM_RATE) -> DriftResult:
    """Test a sensor for drift."""
    if trend.baseline is None:
        return DriftResult(
            "NOT TESTED", "There is no baseline to compare a calibration with; register the sensor again."
        )
    own = trend.find_run(trend.baseline.run_id)
    since = [point for point in trend.independent if _is_since(point, own, trend.baseline)]
    later = [point for point in since if own is None or not point.overlaps(own)]
    if not later:
        return DriftResult("NOT TESTED", _nothing_newer(trend))
    newest = later[-1]
    names, base = newest.names, make_baseline_epoch(trend.baseline, own, newest.names)
    series = [make_epoch(point, names) for point in since if point.timed and set(point.names) == set(names)]
    line = tests.fit_line(series)
    share = alpha / (1 if line is None else 2)
    first = make_epoch(newest, names)
    held = tests.baseline_test(first, base, share)
    slope = None if line is None else tests.slope_test(line, share)
    if held is None:
        return DriftResult(
            "NOT TESTED", f"The covariance of run {newest.run_id} or of the baseline is not positive definite."
        )
    covariance = first.covariance + base.covariance
    found = DriftResult(
        _verdict(held, slope, trend.baseline),
        "",
        names,
        newest,
        first.value - base.value,
        np.sqrt(np.diag(covariance)),
        covariance,
        held,
        slope,
        line,
        len(series),
        held.rejects and _is_jump(newest, later[:-1], share),
    )
    return _with_sentence(found, trend.baseline)


@dataclass(frozen=True)
class Followed:
    """A calibration of the past as the model of the mission takes it."""

    point: TrendPoint
    found: FollowedPass


class Follower:
    """Takes the calibrations of a sensor in by time; those of other parameters are another series."""

    def __init__(self, alpha: float) -> None:
        self._series: defaultdict[frozenset[str], PassForecaster] = defaultdict(lambda: PassForecaster(alpha))

    def follow(self, point: TrendPoint) -> Followed | None:
        """Take a calibration in; None where it does not count, or has no covariance."""
        if point.left_out or not point.timed or not point.names:
            return None
        try:
            found = self._series[frozenset(point.names)].follow(make_epoch(point, sorted(point.names)))
        except np.linalg.LinAlgError:
            return None
        return Followed(point, found)


def _is_jump(newest: TrendPoint, before: Sequence[TrendPoint], alpha: float) -> bool:
    """Whether the calibrations before do not forecast the newest; False where they are too few to."""
    follower = Follower(alpha)
    for point in before[-MOST_FOLLOWED:]:
        follower.follow(point)
    followed = follower.follow(newest)
    return followed is not None and followed.found.is_outside


def _verdict(held: tests.ChiSquareTest, slope: tests.ChiSquareTest | None, baseline: ParameterSet) -> str:
    """Return the verdict as a word; calibrations that change with time drift, whatever the baseline was made from."""
    if slope is not None and slope.rejects:
        return "DRIFT"
    if not held.rejects:
        return "HOLDS"
    return "GROUND SHIFT" if baseline.run_id is None else "DRIFT"


def _is_since(point: TrendPoint, own: TrendPoint | None, baseline: ParameterSet) -> bool:
    if baseline.run_id is None:
        return True
    if own is None:
        return baseline.baseline_from_utc is None or point.at_utc >= baseline.created_utc
    return point.run_id == own.run_id or point.overlaps(own) or point.at_utc > own.at_utc


def _nothing_newer(trend: Trend) -> str:
    name = trend.baseline.name if trend.baseline else "the baseline"
    left = sum(bool(point.left_out) for point in trend.points)
    more = (
        f" {left} of {len(trend.points)} calibrations are not used; see “Calibrations used” on the Trend page."
        if left
        else ""
    )
    return f"Drift cannot be tested: no newer telemetry since {name}. Upload newer telemetry and calibrate it.{more}"


def make_epoch(point: TrendPoint, names: Sequence[str]) -> Epoch:
    """Return a calibration's estimate of these parameters, in their order."""
    order = [point.names.index(name) for name in names]
    days = (datetime.fromisoformat(point.at_utc) - datetime.fromisoformat(EPOCH)).total_seconds() / DAY_S
    value = np.array([point.parameters[name] for name in names], dtype=np.float64)
    warmth = np.nan if point.temperature_c is None else point.temperature_c
    return Epoch(days, value, point.covariance[np.ix_(order, order)], warmth)


def make_baseline_epoch(baseline: ParameterSet, own: TrendPoint | None, names: Sequence[str]) -> Epoch:
    """Return the baseline's estimate, with the covariance of its run where that is known."""
    document = baseline.document["covariance"]
    listed, matrix = list(document["names"]), np.array(document["matrix"], dtype=np.float64)
    if own is not None and set(names) <= set(own.names):
        listed, matrix = list(own.names), own.covariance
    order = [listed.index(name) for name in names]
    value = np.array([baseline.document["parameters"][name] for name in names], dtype=np.float64)
    warmth = np.nan if own is None or own.temperature_c is None else own.temperature_c
    return Epoch(0.0, value, matrix[np.ix_(order, order)], warmth)


def describe_test(test: tests.ChiSquareTest) -> str:
    """Write a statistic and its degrees of freedom, and the limit with its false-alarm probability, as both set it."""
    return f"χ² {number(test.statistic, 3)} for {test.dof} degrees of freedom, {describe_limit(test)}"


def describe_limit(test: tests.ChiSquareTest) -> str:
    """Write a limit with the share of cases in which chance alone exceeds it."""
    return (
        f"limit {number(test.limit, 3)}, which chance alone exceeds in {100 * test.alpha:.2g}{NARROW_SPACE}% of cases"
    )


def _with_sentence(found: DriftResult, baseline: ParameterSet) -> DriftResult:
    """Add a sentence on the findings, tests that reject first."""
    first = [GROUND_SHIFTED] if found.verdict == "GROUND SHIFT" else []
    said = [*first, _say_baseline(found, baseline), *_say_slope(found), *_say_temperature(found)]
    return replace(found, sentence=" ".join(said))


def _say_baseline(found: DriftResult, baseline: ParameterSet) -> str:
    if found.holds is None or found.newest is None or found.largest is None:
        return ""
    name, worth = found.largest
    numbers = describe_test(found.holds)
    if found.holds.rejects:
        moved = f"the largest change is in {quantity(name).symbol}: {fixed(worth, 1)} σ of the difference"
        return f"Run {found.newest.run_id} does not agree with {baseline.name} ({numbers}); {moved}."
    return f"Run {found.newest.run_id} agrees with {baseline.name} ({numbers})."


def _say_slope(found: DriftResult) -> list[str]:
    if found.slope is None or found.line is None:
        return [
            "Too few calibrations since the baseline to estimate a slope; at least three at different times are needed."
        ]
    said = "change with time" if found.slope.rejects else "do not change with time"
    numbers = describe_test(found.slope)
    sentences = [f"The parameters of {found.counted} calibrations since the baseline {said} ({numbers})."]
    if found.line.inflation > 1.0:
        factor = fixed(found.line.inflation**0.5, 2)
        sentences.append(
            f"They scatter {factor} times as much as their sigmas predict; the slope's sigmas are widened by that factor."
        )
    return sentences


def _say_temperature(found: DriftResult) -> list[str]:
    if found.line is None or found.line.thermal_per_c is None or found.line.thermal_covariance is None:
        return []
    statistic = tests.mahalanobis(found.line.thermal_per_c, found.line.thermal_covariance)
    if statistic is None:
        return []
    test = tests.chi_square_test(statistic, len(found.names), FALSE_ALARM_RATE)
    return ["The parameters also change with temperature; the slope excludes this effect."] if test.rejects else []


def document(found: DriftResult) -> documents.Drift:
    """Write what the tests say, SI."""
    line = found.line
    return documents.Drift(
        verdict=found.verdict,
        sentence=found.sentence,
        false_alarm_rate=FALSE_ALARM_RATE,
        run_id=None if found.newest is None else found.newest.run_id,
        names=list(found.names),
        difference=_listed(found.names, found.difference),
        sigma=_listed(found.names, found.sigma),
        baseline_holds=_test(found.holds),
        slope=_test(found.slope),
        calibrations_on_the_line=found.counted,
        slope_per_day=_listed(found.names, None if line is None else line.slope_per_d),
        slope_sigma_per_day=_listed(found.names, None if line is None else np.sqrt(np.diag(line.slope_covariance))),
        change_per_c=_listed(found.names, None if line is None else line.thermal_per_c),
    )


def _listed(names: Sequence[str], values: FloatArray | None) -> Values[float] | None:
    return None if values is None else Values(dict(zip(names, values.tolist(), strict=True)))


def _test(test: tests.ChiSquareTest | None) -> documents.DriftTest | None:
    if test is None:
        return None
    return documents.DriftTest(statistic=test.statistic, dof=test.dof, limit=test.limit, p=test.p, rejects=test.rejects)
