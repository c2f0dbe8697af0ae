"""What a run would be, before it is queued: its size, its time, what it will know, and what to beware of.

Forecasts of runs, kept by what they follow from: the table's content address, the sensor's document, the settings.

A forecast takes a tenth of a second and a form asks for one at every change, so those that were made are kept, the latest of them.
One that cannot be made is a sentence and no refusal: the run may be queued all the same, and will say why it cannot do more.

How much work a run is, before it begins: arcs, seconds.

An exposure of N stars gives 2N-3 arcs, so S stars in X exposures give 2S - 3X. The time is that of the newest runs of
the same method, scaled by the number of stars: every estimator here is linear in it. Where no run has been made yet, a
careful guess is used, and its spread is as wide as machines differ. A replayed run lasts as long as its frames take to come
down; what it computes meanwhile is not seen, so its pace is used only where no other run has been made, less that wait.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from boresight.calibration.evaluation.forecast import MOST_FRAMES, MOST_STARS, forecast
from boresight.calibration.options import CalibrationSettings
from boresight.console.runs.queries import recent_runs
from boresight.console.runs.requests import RunRequest
from boresight.errors import BoresightError, CorruptFileError
from boresight.platform.blobs.folder import BlobStore
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.read.frames import read_sample
from boresight.telemetry.sensors import parse_sensor

KEPT = 500


@dataclass(frozen=True)
class ForecastSources:
    """What a dry run may look at besides the rows: stored tables and the star catalogue."""

    blobs: BlobStore
    catalogue: Callable[[], Catalogue | None]
    catalogue_folder: Path
    _made: OrderedDict[str, dict[str, Any]] = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def forecast(
        self, table_sha256: str, sensor_document: Mapping[str, Any], settings: CalibrationSettings
    ) -> dict[str, Any]:
        """Foretell a run; see `calibration.evaluation.forecast`. Without a forecast `at` is None and `sentence` says why."""
        key = compute_sha256([table_sha256, dict(sensor_document), settings.document()])
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        try:
            made = self._forecast(table_sha256, sensor_document, settings)
        except CorruptFileError as error:  # until it is restored
            return unseen(str(error).rstrip("."))
        with self._lock:
            self._made[key] = made
            while len(self._made) > KEPT:
                self._made.popitem(last=False)
        return made

    def _forecast(
        self, table_sha256: str, sensor_document: Mapping[str, Any], settings: CalibrationSettings
    ) -> dict[str, Any]:
        """Read the sample and foretell, or say why not."""
        try:
            sample = read_sample(table_path(self.blobs, table_sha256), MOST_FRAMES, MOST_STARS)
            if (catalogue := self.catalogue()) is None:
                return unseen("this server has no star catalogue")
            return forecast(sample, parse_sensor(sensor_document), catalogue, settings, self.catalogue_folder)
        except CorruptFileError:
            raise
        except BoresightError as error:
            return unseen(str(error).rstrip("."))


def unseen(why: str) -> dict[str, Any]:
    """Return the forecast of a run that nothing can be foretold of."""
    return {
        "sentence": f"No sigma can be foretold: {why}.",
        "free": [],
        "sigma": {},
        "typical_sigma": {},
        "weak": None,
        "weak_directions": [],
        "help": [],
        "observability": None,
        "frames_sampled": 0,
        "frames": 0,
        "at": None,
    }


FIRST_GUESS_S_PER_STAR = 5e-5
#: How many times slower or faster than the guess a machine and a method may be.
GUESS_SPREAD = 4.0
START_S = 0.02
#: The newest runs of a method that its pace is taken from.
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
    """What a finished run was and how long its computing took, without its wait for frames."""

    stars: int
    seconds: float


def list_timed_runs(session: Session, method: str) -> list[TimedRun]:
    """Return what the newest runs of a method took, newest first: of those that waited for no frames where there are any."""
    timed = [run for run in recent_runs(session, method, RUNS_TIMED) if run[1].get("seconds") and run[1].get("stars")]
    unthrottled = [run for run in timed if not _downlink_s(run[0], frames=1)]
    return [TimedRun(summary["stars"], _computed_s(settings, summary)) for settings, summary in unthrottled or timed]


def estimate_run_speed(session: Session, method: str) -> RunSpeed:
    """Return the pace of the newest runs of a method; a careful guess before there is one."""
    paces = [run.seconds / run.stars for run in list_timed_runs(session, method)]
    if not paces:
        guess = FIRST_GUESS_S_PER_STAR
        return RunSpeed(guess, guess / GUESS_SPREAD, guess * GUESS_SPREAD, 0)
    if len(paces) == 1:
        return RunSpeed(paces[0], paces[0] / 2, paces[0] * 2, 1)
    tenths = quantiles(paces, n=10, method="inclusive")
    return RunSpeed(median(paces), tenths[0], tenths[-1], len(paces))


def estimate_seconds_per_star(session: Session, method: str) -> float:
    """Return the median pace of the newest runs of a method."""
    return estimate_run_speed(session, method).s_per_star


def predict_duration_s(settings: Mapping[str, Any], frames: int, stars: int, pace_s_per_star: float) -> float:
    """Return how long a run will take, seconds."""
    return START_S + stars * pace_s_per_star + _downlink_s(settings, frames)


def _downlink_s(settings: Mapping[str, Any], frames: int) -> float:
    """Return how long a replay waits for its frames, seconds; 0 where nothing is replayed."""
    replay = float(settings.get("replay_frames_per_s") or 0.0)
    return frames / replay if replay > 0 else 0.0


def _computed_s(settings: Mapping[str, Any], summary: Mapping[str, Any]) -> float:
    """Return the seconds of a past run without its wait for frames, at least `START_S` where it waited."""
    waited = _downlink_s(settings, summary.get("frames") or 0)
    return max(float(summary["seconds"]) - waited, START_S) if waited else float(summary["seconds"])


def count_pairs(stars: int, exposures: int) -> int:
    """Return the number of arcs of `stars` spread over `exposures`."""
    return max(0, 2 * stars - 3 * exposures)


def dry_run(session: Session, order: RunRequest, sight: ForecastSources | None = None) -> dict[str, Any]:
    """Say what a run would be."""
    telemetry, settings = order.telemetry, order.settings
    free = list(settings.free or parse_sensor(order.sensor.document).free)
    quality = telemetry.quality
    exposures = quality.get("usable_exposures", telemetry.frames)
    pairs = count_pairs(quality.get("usable", telemetry.stars), exposures)
    pace = estimate_run_speed(session, settings.method)
    seconds = [
        round(predict_duration_s(settings.document(), telemetry.frames, telemetry.stars, one), 3)
        for one in (pace.s_per_star, pace.low, pace.high)
    ]
    forecast = None
    if sight is not None:
        forecast = sight.forecast(telemetry.table_sha256, order.sensor.document, settings)
    return {
        "sensor": order.sensor.name,
        "telemetry_set": telemetry.name,
        "validation_set": None if order.validation is None else order.validation.name,
        "settings": settings.document(),
        "frames": telemetry.frames,
        "exposures": exposures,
        "stars": telemetry.stars,
        "pairs": pairs,
        "free": free,
        "predicted_s": seconds[0],
        "predicted_range_s": seconds[1:],
        "paced_by": pace.runs,
        "forecast": forecast,
        "warnings": _warnings(order, free, pairs),
    }


def expected_s(session: Session, orders: Sequence[RunRequest]) -> float:
    """Return how long runs of one method will take together, seconds of computing."""
    if not orders:
        return 0.0
    pace = estimate_run_speed(session, orders[0].settings.method).s_per_star
    settings = orders[0].settings.document()
    return round(
        sum(predict_duration_s(settings, order.telemetry.frames, order.telemetry.stars, pace) for order in orders), 3
    )


def _warnings(order: RunRequest, free: Sequence[str], pairs: int) -> list[str]:
    """Gather what an analyst should know before queueing."""
    warnings = [str(sentence) for sentence in order.telemetry.quality.get("warnings") or ()]
    if pairs < 10 * len(free):
        warnings.append(f"About {pairs} arcs for {len(free)} parameters is little; free fewer or use a longer set.")
    if order.validation is None:
        warnings.append("Without a validation set nothing independent will say whether the result is better.")
    return warnings
