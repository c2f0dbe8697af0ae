"""A sensor's trend as one JSON document, SI, and one answer to "recalibrate now?".

- `YES`: it drifts, its ground calibration does not hold or can be replaced, its baseline is over its age and there is
  newer telemetry, or newer telemetry would at least halve the sigmas.
- `MORE DATA NEEDED`: nothing is newer than the baseline's data, or too coarse to see a change of three of its sigmas; or only
  the newest calibration stands apart, from the baseline and from the line through those before it.
- `NOT YET`: the newest calibration agrees with the baseline.

Sigmas with further data are foretold by the number of stars, sigma = sigma_0 sqrt(S_0 / S).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

from boresight.calibration.calibration import Values
from boresight.calibration.parameter_set import parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.console.fleet import trend as drifts
from boresight.console.fleet.status import OLD_DAYS, count_days_since
from boresight.console.fleet.trend import (
    GROUND_SHIFTED,
    DriftResult,
    Trend,
    TrendPoint,
    get_time_span,
    judge_drift,
    read_trend,
)
from boresight.console.notes.queries import list_annotations
from boresight.console.notes.tables import Annotation
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.db.sessions import Session
from boresight.verdicts import trend as documents
from boresight.verdicts.numbers import count, fixed

HALVED = 0.5
TOO_COARSE = 3.0  # of the baseline's sigmas


@dataclass(frozen=True)
class Advice:
    """Whether to recalibrate now, and the kind of advice that this is."""

    answer: documents.Answer
    sentence: str
    code: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnseenTelemetry:
    """The telemetry that is newer than the baseline's data."""

    sets: Sequence[TelemetrySet]
    untried: Sequence[TelemetrySet]
    failed: Sequence[TelemetrySet]
    ratio: float | None

    @property
    def stars(self) -> int:
        """How many stars they have."""
        return sum(row.stars for row in self.sets)


def advise(trend: Trend, drift: DriftResult | None = None) -> Advice:
    """Say whether to recalibrate a sensor now: the first of the rules above that fits."""
    drift = drift or judge_drift(trend)
    if trend.baseline is None:
        return Advice("MORE DATA NEEDED", "There is no baseline; register the sensor again.", "trend_no_baseline")
    data, age_d = find_unseen_telemetry(trend), count_days_since(trend.baseline)
    first = next(_rules(drift, data, trend.baseline, age_d))
    return replace(first, reasons=tuple(_reasons(drift, data, trend.baseline, age_d)))


def _rules(drift: DriftResult, data: UnseenTelemetry, baseline: ParameterSet, age_d: float | None) -> Iterator[Advice]:
    """Yield the answers that fit, the gravest first; there is always one."""
    name, ratio = baseline.name, data.ratio
    more: documents.Answer = "MORE DATA NEEDED"
    if drift.verdict == "DRIFT" and drift.is_jump and drift.newest is not None:
        apart = f"Run {drift.newest.run_id} agrees neither with {name} nor with the trend of earlier calibrations"
        said = f"{apart}. This is a jump or wrong data: calibrate another pass before deciding."
        yield Advice(more, said, "trend_jump")
    if drift.verdict == "DRIFT":
        yield Advice("YES", f"Recalibrate: {name} is no longer valid.", "trend_drift")
    if drift.verdict == "GROUND SHIFT":
        yield Advice("YES", GROUND_SHIFTED, "trend_ground_shift")
    if not data.sets:
        said = f"No telemetry is newer than that of {name}: upload a pass for calibration."
        yield Advice(more, said, "trend_no_data")
    if baseline.run_id is None:
        said = f"Recalibrate: {name} was made on the ground, and there is telemetry to replace it."
        yield Advice("YES", said, "trend_ground")
    if ratio is not None and ratio > TOO_COARSE:
        coarse = f"With the {count(data.stars)} stars available, one sigma would be {fixed(ratio, 1)} times that of the baseline"
        yield Advice(more, f"{coarse}: wait for more frames.", "trend_coarse")
    if age_d is not None and age_d > OLD_DAYS:
        said = f"Recalibrate: {name} is older than {OLD_DAYS:.0f} days and newer data are available."
        yield Advice("YES", said, "trend_old")
    if ratio is not None and ratio <= HALVED:
        said = f"Recalibrate: with the data available, every sigma would be at most {fixed(ratio, 2)} times that of the baseline."
        yield Advice("YES", said, "trend_halved")
    if drift.verdict == "NOT TESTED":
        said = f"Calibrate {data.sets[-1].name}: it is newer than {name} and not calibrated yet."
        yield Advice("YES", said, "trend_untested")
    yield Advice("NOT YET", f"{name} is still valid, and newer data would not improve it much.", "trend_valid")


def find_unseen_telemetry(trend: Trend) -> UnseenTelemetry:
    """Return the telemetry that is newer than the baseline's data, and how much it would improve the sigmas."""
    own = trend.find_run(trend.baseline.run_id) if trend.baseline else None
    sets = [
        row
        for row in trend.telemetry.values()
        if row.purpose == "calibration" and row.archived_utc is None and _is_newer(row, own, trend.baseline)
    ]
    sets.sort(key=get_time_span)
    failed, sets = [row for row in sets if row.id in trend.failed], [row for row in sets if row.id not in trend.failed]
    tried = {point.telemetry_set_id for point in trend.points if point.names}
    untried = [row for row in sets if row.id not in tried]
    return UnseenTelemetry(sets, untried, failed, _ratio(trend, own, sum(row.stars for row in sets)))


def _is_newer(row: TelemetrySet, own: TrendPoint | None, baseline: ParameterSet | None) -> bool:
    """Whether a set's data begin after those of the baseline end."""
    if baseline is None or baseline.run_id is None:
        return True
    begins_utc, _, timed = get_time_span(row)
    if own is None or not (timed and own.timed):
        return row.uploaded_utc > baseline.created_utc
    return begins_utc > own.ends_utc


def _ratio(trend: Trend, own: TrendPoint | None, stars: int) -> float | None:
    """Predict the ratio of the sigma with so many stars to the baseline's, the largest over all parameters."""
    if trend.baseline is None or not trend.independent or not stars:
        return None
    like = own or trend.independent[-1]
    sigma = parse_parameter_set(trend.baseline.document).reliable_sigma
    shared = [like.sigma[name] / known for name in like.names if (known := sigma.get(name))]
    return max(shared) * (like.stars / stars) ** 0.5 if shared and like.stars else None


def _reasons(drift: DriftResult, data: UnseenTelemetry, baseline: ParameterSet, age_d: float | None) -> Sequence[str]:
    said = [drift.sentence]
    if data.sets:
        kinds = f"{len(data.sets)} set{'s' * (len(data.sets) > 1)} of {count(data.stars)} stars"
        untried = f", {len(data.untried)} not calibrated yet" if data.untried else ""
        said.append(f"Newer than the baseline's data: {kinds}{untried}.")
    if data.failed:
        name = f"{data.failed[-1].name}{f' and {len(data.failed) - 1} more' if len(data.failed) > 1 else ''}"
        said.append(f"Not counted: {name}, whose latest calibration failed; see its run page for the cause.")
    if data.ratio is not None:
        said.append(
            f"With them, every sigma is predicted to be at most {fixed(data.ratio, 2)} times that of the baseline."
        )
    if age_d is not None:
        days = round(age_d)
        when = f"{days} day{'s' * (days > 1)} ago" if days else "today"
        said.append(f"{baseline.name} became the baseline {when}; the age limit is {OLD_DAYS:.0f} days.")
    return said


def make_trend_document(session: Session, sensor_id: int) -> documents.Trend:
    """Return a sensor over the mission, with the drift tests and the advice."""
    trend = read_trend(session, sensor_id)
    found = judge_drift(trend)
    return write_trend_document(trend, found, advise(trend, found), list_annotations(session, sensor_id))


def write_trend_document(
    trend: Trend, found: DriftResult, advice: Advice, annotations: Sequence[Annotation] = ()
) -> documents.Trend:
    """Write a trend."""
    baseline = trend.baseline
    return documents.Trend(
        sensor_id=trend.sensor.id,
        sensor=trend.sensor.name,
        camera_model=trend.camera_model,
        parameter_names=list(CAMERA_MODELS[trend.camera_model].parameter_names),
        baseline=None if baseline is None else documents.SetName(parameter_set_id=baseline.id, name=baseline.name),
        points=[_point(point) for point in trend.points],
        others=[_point(point) for point in trend.others],
        baselines=list(trend.periods),
        on_board=list(trend.on_board),
        truth=None if trend.sensor.truth is None else Values(trend.sensor.truth),
        annotations=[
            documents.TrendAnnotation(
                at_utc=row.at_utc, text=row.text, printed_name=row.printed_name, made_utc=row.made_utc
            )
            for row in annotations
        ],
        drift=drifts.document(found),
        advice=documents.Advice(
            answer=advice.answer, sentence=advice.sentence, code=advice.code, reasons=list(advice.reasons)
        ),
    )


def _point(point: TrendPoint) -> documents.TrendPoint:
    said = {
        "parameters": Values({name: point.parameters[name] for name in point.names}),
        "sigma": Values(point.sigma),
        "left_out": point.left_out or None,
        "said": point.said or None,
    }
    return documents.TrendPoint(**({one.name: getattr(point, one.name) for one in fields(documents.TrendPoint)} | said))
