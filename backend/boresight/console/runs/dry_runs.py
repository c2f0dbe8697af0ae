"""Dry runs: the checked request of a run, its size, its expected time and warnings, before it is queued.

An exposure of N stars gives 2N-3 arcs. The time is that of the newest runs of the same method by the number of stars,
else a cautious default; a replayed run counts only where there is no other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median, quantiles
from typing import Any

from boresight.calibration.joint.passes import MOST_PASSES
from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.console.fleet.tables import Sensor
from boresight.console.runs.queries import list_recent_runs
from boresight.console.runs.starts import Start, check_start, find_start
from boresight.console.telemetry.tables import TelemetrySet, find_diagnosis, find_quality
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.sensors import parse_sensor

LABEL_LENGTH = 200


@dataclass(frozen=True)
class RunRequest:
    """A checked request for a run."""

    sensor: Sensor
    telemetry: TelemetrySet
    validation: TelemetrySet | None
    settings: CalibrationSettings
    label: str
    further: Sequence[TelemetrySet] = ()
    start: Start | None = None

    @property
    def fitted(self) -> list[TelemetrySet]:
        """The sets whose stars count: all but those that the prior holds."""
        held = self.start.held if self.start else frozenset()
        return [one for one in (self.telemetry, *self.further) if one.id not in held]

    @property
    def left_out(self) -> list[TelemetrySet]:
        """The sets that the prior holds already."""
        return [one for one in (self.telemetry, *self.further) if one not in self.fitted]

    def columns(self) -> dict[str, Any]:
        """Return the columns of a run's row that are fixed at its launch."""
        return {
            "sensor_id": self.sensor.id,
            "telemetry_set_id": self.telemetry.id,
            "validation_set_id": None if self.validation is None else self.validation.id,
            "method": self.settings.method,
            "settings": self.settings.document(),
            "sensor_document": self.sensor.document,
            "label": self.label,
            "joint_set_ids": [one.id for one in self.further],
            "prior_run_id": None if self.start is None else self.start.run.id,
            "prior_set_id": None if self.start is None or self.start.named is None else self.start.named.id,
        }

    def on_record(self) -> dict[str, Any]:
        """Return the audit record's document of a launch."""
        more: dict[str, Any] = {}
        if self.further:
            more["joint_sets"] = [one.name for one in self.further]
        if self.start is not None:
            more["prior"] = self.start.name
            more["prior_result_sha256"] = self.start.run.result_sha256
        return {
            "sensor": self.sensor.name,
            "telemetry_set": self.telemetry.name,
            "settings": self.settings.document(),
            **more,
        }


def check_run_request(  # noqa: PLR0913 - the choices of a run
    session: Session,
    sensor_id: int,
    telemetry_set_id: int,
    settings: Mapping[str, Any],
    validation_set_id: int | None = None,
    label: str = "",
    *,
    joint_set_ids: Sequence[int] = (),
    prior_run_id: int | None = None,
    prior_set_id: int | None = None,
) -> RunRequest:
    """Check the choices of a run for consistency."""
    sensor = session.get_known(Sensor, sensor_id)
    telemetry = _get_set(session, sensor, telemetry_set_id)
    further = _get_further(session, sensor, telemetry, joint_set_ids)
    validation = None if validation_set_id is None else _get_set(session, sensor, validation_set_id)
    if validation is not None and validation in (telemetry, *further):
        raise RefusedInputError(
            f"{validation.name} cannot validate a calibration that was made from it; choose another set.",
            code="validates-itself",
        )
    refuse_label(label)
    parsed = CalibrationSettings.parse(settings)
    known = CAMERA_MODELS[sensor.document["camera_model"]].parameter_names
    if strange := [name for name in parsed.free or () if name not in known]:
        raise RefusedInputError(f"{sensor.name} has no parameter {', '.join(strange)}; choose from {', '.join(known)}.")
    start = find_start(session, sensor, prior_run_id, prior_set_id)
    check_start(sensor, (telemetry, *further), validation, parsed, start)
    return RunRequest(sensor, telemetry, validation, parsed, label.strip(), further, start)


def _get_further(
    session: Session, sensor: Sensor, telemetry: TelemetrySet, set_ids: Sequence[int]
) -> list[TelemetrySet]:
    """Return the sets that a run takes with its first."""
    if len(set_ids) >= MOST_PASSES:
        raise RefusedInputError(
            f"{len(set_ids) + 1:,} sets were named; name at most {MOST_PASSES:,}, or put those of a day together."
        )
    further = [_get_set(session, sensor, number) for number in set_ids]
    for place, one in enumerate(further):
        if one in (telemetry, *further[:place]):
            raise RefusedInputError(
                f"{one.name} is named twice; name each set once, or its stars count twice.", code="named-twice"
            )
    return further


def refuse_label(label: str) -> None:
    """Refuse a label that is too long or holds control characters."""
    if len(label) > LABEL_LENGTH:
        raise RefusedInputError(f"The label has {len(label)} characters; shorten it to {LABEL_LENGTH}.")
    refuse_control_characters(label=label)


def _get_set(session: Session, sensor: Sensor, set_id: int) -> TelemetrySet:
    found = session.get_known(TelemetrySet, set_id)
    if found.sensor_id != sensor.id:
        raise RefusedInputError(
            f"{found.name} is telemetry of another sensor; choose a set of {sensor.name}.", code="other-sensor"
        )
    if found.archived_utc is not None:
        raise ConflictError(
            f"{found.name} was archived on {found.archived_utc[:10]}; choose a set that is in use.", code="archived"
        )
    return found


FIRST_GUESS_S_PER_STAR = 5e-5
#: How many times slower or faster than the guess a machine and a method may be.
GUESS_SPREAD = 4.0
START_S = 0.02
#: How many of the newest runs of a method its speed is estimated from.
RUNS_TIMED = 20


@dataclass(frozen=True)
class RunSpeed:
    """How fast runs of a method are.

    `s_per_star`: Median, seconds a star.
    """

    s_per_star: float
    low: float
    high: float
    runs: int


@dataclass(frozen=True)
class TimedRun:
    """A finished run with its size and its computing time, without its wait for frames."""

    stars: int
    seconds: float


def list_timed_runs(session: Session, method: str) -> list[TimedRun]:
    """Return the times of a method's newest runs, newest first; replayed runs only where there are no others."""
    timed = [
        (settings, found.frames or 0, TimedRun(found.stars, found.seconds))
        for settings, found in list_recent_runs(session, method, RUNS_TIMED)
        if found.seconds and found.stars
    ]
    unthrottled = [run for run in timed if not _downlink_s(run[0], frames=1)]
    return [
        replace(run, seconds=_computed_s(settings, frames, run.seconds))
        for settings, frames, run in unthrottled or timed
    ]


def estimate_run_speed(session: Session, method: str) -> RunSpeed:
    """Return the speed of the newest runs of a method; a cautious default where there is none."""
    speeds = [run.seconds / run.stars for run in list_timed_runs(session, method)]
    if not speeds:
        guess = FIRST_GUESS_S_PER_STAR
        return RunSpeed(guess, guess / GUESS_SPREAD, guess * GUESS_SPREAD, 0)
    if len(speeds) == 1:
        return RunSpeed(speeds[0], speeds[0] / 2, speeds[0] * 2, 1)
    tenths = quantiles(speeds, n=10, method="inclusive")
    return RunSpeed(median(speeds), tenths[0], tenths[-1], len(speeds))


def estimate_seconds_per_star(session: Session, method: str) -> float:
    """Return the median time per star of the newest runs of a method."""
    return estimate_run_speed(session, method).s_per_star


def predict_duration_s(settings: CalibrationSettings, frames: int, stars: int, pace_s_per_star: float) -> float:
    """Return how long a run will take, seconds."""
    return START_S + stars * pace_s_per_star + _downlink_s(settings, frames)


def _downlink_s(settings: CalibrationSettings, frames: int) -> float:
    """Return how long a replay waits for its frames, seconds; 0 where nothing is replayed."""
    replay = settings.replay_frames_per_s
    return frames / replay if replay > 0 else 0.0


def _computed_s(settings: CalibrationSettings, frames: int, seconds: float) -> float:
    """Return the seconds of a past run without its wait for frames, at least `START_S` where it waited."""
    waited = _downlink_s(settings, frames)
    return max(seconds - waited, START_S) if waited else seconds


def count_pairs(stars: int, exposures: int) -> int:
    """Return the number of arcs of `stars` spread over `exposures`."""
    return max(0, 2 * stars - 3 * exposures)


def dry_run(session: Session, request: RunRequest, forecast_sources: ForecastSources | None = None) -> dict[str, Any]:
    """Return the summary of a dry run."""
    telemetry, settings, fitted = request.telemetry, request.settings, request.fitted
    free = list(settings.free or parse_sensor(request.sensor.document).free)
    qualities = [(one, find_quality(one.quality)) for one in fitted]
    frames, stars = sum(one.frames for one in fitted), sum(one.stars for one in fitted)
    exposures = sum(
        one.frames if quality.usable_exposures is None else quality.usable_exposures for one, quality in qualities
    )
    pairs = count_pairs(
        sum(one.stars if quality.usable is None else quality.usable for one, quality in qualities), exposures
    )
    pace = estimate_run_speed(session, settings.method)
    seconds = [
        round(predict_duration_s(settings, frames, stars, one), 3) for one in (pace.s_per_star, pace.low, pace.high)
    ]
    forecast = None
    if forecast_sources is not None and not request.further and request.start is None:  # it is of one set by itself
        forecast = forecast_sources.forecast(telemetry.table_sha256, request.sensor.document, settings)
    named = all(not recognised(one) for one in fitted)
    return {
        "sensor": request.sensor.name,
        "telemetry_set": telemetry.name,
        "joint_sets": [one.name for one in request.further],
        "validation_set": None if request.validation is None else request.validation.name,
        "prior": None if request.start is None else request.start.name,
        "left_out": [one.name for one in request.left_out],
        "settings": settings.document(),
        "frames": frames,
        "exposures": exposures,
        "stars": stars,
        "pairs": pairs,
        "free": free,
        "predicted_s": seconds[0],
        "predicted_range_s": seconds[1:],
        "paced_by": pace.runs,
        "forecast": forecast,
        "warnings": [
            *dict.fromkeys(one for _, quality in qualities for one in quality.warnings),
            *_warnings(request, free, pairs if named else None),
        ],
    }


def estimate_s(session: Session, requests: Sequence[RunRequest]) -> float:
    """Return the total computing time of runs of one method, seconds."""
    if not requests:
        return 0.0
    pace = estimate_run_speed(session, requests[0].settings.method).s_per_star
    settings = requests[0].settings
    return round(
        sum(
            predict_duration_s(settings, request.telemetry.frames, request.telemetry.stars, pace)
            for request in requests
        ),
        3,
    )


def recognised(telemetry: TelemetrySet) -> bool:
    """Whether a diagnosis says that most of a set matches as it stands, whatever of it is named."""
    found = find_diagnosis(telemetry.quality)
    return found is not None and (found.fits or 2 * found.exposures_solved_before > found.exposures)


def _warnings(request: RunRequest, free: Sequence[str], pairs: int | None) -> list[str]:
    """What to know before a run; `pairs` is None where names do not tell how many arcs there are."""
    warnings = []
    if (held := [one.name for one in request.left_out]) and request.start is not None:
        warnings.append(f"Not counted again, because {request.start.name} already contains it: {', '.join(held)}.")
    if pairs is not None and request.start is None and pairs < 10 * len(free):
        warnings.append(
            f"About {pairs} arcs may be too few for {len(free)} parameters; free fewer or use a longer set."
        )
    if request.validation is None:
        warnings.append("Without a validation set, there is no independent check of whether the result is better.")
    return warnings
