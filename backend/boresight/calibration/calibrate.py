"""The one function that calibrates: problem and method in, a calibration out, with progress on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from boresight.calibration import result
from boresight.calibration.advice_kinds import Advice, make_advice
from boresight.calibration.assumptions import list_assumptions
from boresight.calibration.calibration import (
    Assumption,
    Calibration,
    InputPass,
    JudgedOn,
    Minima,
    Noise,
    PassVariation,
    PriorUse,
    RemovedOf,
    StarsOffDetector,
    Trust,
)
from boresight.calibration.corrections import Corrections
from boresight.calibration.estimate import Asked, Estimate, Parameters, never
from boresight.calibration.evaluation.pixel_residuals import FreeCovariance
from boresight.calibration.evaluation.result_evaluation import evaluate_result, validate, with_advice
from boresight.calibration.joint.drift import estimate_drift, shows_drift
from boresight.calibration.joint.passes import JointTelemetry, list_passes
from boresight.calibration.joint.passes_fit import judge_passes
from boresight.calibration.joint.prior import (
    PriorSource,
    TakenPrior,
    check_same_camera,
    refuse_vary,
    refuse_without_prior,
    take_prior,
    without_held,
)
from boresight.calibration.joint.variation import OPEN_SIGMAS, check_variation, fit_variation, refuse_one_pass
from boresight.calibration.matching.match_report import CyclesEnd, Estimation
from boresight.calibration.matching.matched import Dataset, Matched
from boresight.calibration.matching.verification import advise
from boresight.calibration.minima import (
    LowerMinimum,
    describe_minima,
    describe_minima_of_filter,
    look_about_filter,
    minima_advice,
)
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.process_noise import choose_drift, describe_process_noise, free_names
from boresight.calibration.smoothing import describe_smoothed
from boresight.calibration.telemetry_pieces import (
    JUDGED_STARS,
    PREPARED,
    TelemetryInput,
    copied,
    is_large,
    read_whole,
)
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.executor import Executor, LocalExecutor, refuse_cancelled
from boresight.sky.catalogue import Catalogue
from boresight.sky.matching import EXPOSURE_REASONS
from boresight.telemetry.quality.detector import OffDetector, OffDetectorError, check_against_sensor
from boresight.telemetry.schema import Telemetry, joined
from boresight.telemetry.sensors import Sensor
from boresight.waiting import report_waits_to

#: Seconds between two progress reports with a partial result.
REPORT_EVERY_S = 0.25
#: Most of the time that may go into reports, for on a long set each costs many passes over it.
REPORT_SHARE = 0.2


@dataclass(frozen=True)
class Progress:
    """How far a calibration is."""

    fraction: float
    message: str
    partial: Calibration | None


class ProgressReporter:
    """Turns estimates on their way into progress reports with a partial result, as often as is worth it."""

    def __init__(
        self,
        problem: Problem,
        parameters: Parameters,
        settings: CalibrationSettings,
        sha256s: Mapping[str, str],
        report: Callable[[Progress], None] | None,
        begins: float = 0.0,
    ) -> None:
        self._of = (problem, parameters, settings)
        self._sha256s = sha256s
        self._report = report
        self._begins = begins  # share of the progress that is made before the estimator begins
        self._due = time.perf_counter() + REPORT_EVERY_S  # what is over sooner is not waited for

    def __call__(self, estimate: Estimate, fraction: float, message: str) -> None:
        """Report one estimate when it is time to."""
        began = time.perf_counter()
        if self._report is None or began < self._due:
            return
        partial = replace(
            result.describe_estimate(*self._of, estimate, self._sha256s), frames_done=self._frames_done(estimate)
        )
        self._report(Progress(self._begins + (1 - self._begins) * fraction, message, partial))
        ended = time.perf_counter()
        self._due = ended + max(REPORT_EVERY_S, (ended - began) / REPORT_SHARE)

    def _frames_done(self, estimate: Estimate) -> int | None:
        """Count the frames of the set up to the last that a filter took in; its first update may be of several."""
        if not estimate.history:
            return None
        last = estimate.history.taken(np.array([len(estimate.history) - 1]))["frame"]
        return int(self._of[0].find_place(last + 1)[0])


@dataclass(frozen=True)
class CalibrationContext:
    """The context of a calibration: its folders, its executor and its progress callback."""

    cancelled: Callable[[], bool]
    report: Callable[[Progress], None] | None = None
    cache_folder: Path | None = None
    scratch_folder: Path | None = None
    executor: Executor | None = None

    @contextmanager
    def folder(self) -> Iterator[Path]:
        """Give a folder that is gone at the end."""
        with TemporaryDirectory(prefix="boresight-calibration-", dir=self.scratch_folder) as folder:
            yield Path(folder)

    def tell(self, fraction: float, message: str) -> None:
        """Report how far the preparation of a large set is."""
        if self.report is not None:
            self.report(Progress(PREPARED * fraction, message, None))


@contextmanager
def open_dataset(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    context: CalibrationContext,
    corrections: Corrections,
) -> Iterator[tuple[Dataset, OffDetector]]:
    """Make a set ready, put right as `corrections` say, and say which stars of it lie off the detector.

    While the context lasts it can be matched and computed on.
    """
    if not is_large(telemetry):
        measured = read_whole(telemetry)
        off = check_against_sensor(measured, sensor)
        chosen = choose_match_mode(measured, settings)
        inside = corrections.apply(measured, whole=True)
        yield Dataset(inside, sensor, catalogue, parameters, chosen, context.cache_folder), off
        return
    executor = context.executor or LocalExecutor(context.cancelled)
    with context.folder() as folder:
        correct = corrections.apply if corrections.needed else None
        copy = copied(telemetry, sensor, folder, executor, context.tell, context.cancelled, correct)
        chosen = choose_match_mode(copy.pieces[0].read(), settings)
        sets = Dataset(copy, sensor, catalogue, parameters, chosen, context.cache_folder, context.tell)
        yield sets, copy.off_detector


def choose_match_mode(telemetry: Telemetry, settings: CalibrationSettings) -> CalibrationSettings:
    """Let the matches of a file stand that gives directions but names no stars: there is nothing to match them with."""
    if telemetry.star_id is None and telemetry.ra_rad is not None:
        return replace(settings, match="given")
    return settings


def open_validation_set(telemetry: TelemetryInput, sensor: Sensor, most_rows: int) -> tuple[Telemetry, OffDetector]:
    """Read a validation set, of a large one parts that are evenly spread over it.

    Say which stars of all are off the detector.
    """
    if not is_large(telemetry):
        inside = read_whole(telemetry)
        return inside, check_against_sensor(inside, sensor)
    kept: list[Telemetry] = []
    every, off = 1, OffDetector()
    for number, chunk in enumerate(telemetry.chunks()):
        off.look_at(chunk, sensor)
        if number % every == 0:
            kept.append(chunk)
        if sum(map(len, kept)) > most_rows and len(kept) > 1:
            kept, every = kept[::2], 2 * every
    off.refuse()
    return joined(kept), off


def calibrate(  # noqa: PLR0913 - what is calibrated, and eight choices of the caller by name
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    *,
    validation: TelemetryInput | None = None,
    prior: PriorSource | None = None,
    sha256s: Mapping[str, str] | None = None,
    report: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache_folder: Path | None = None,
    scratch_folder: Path | None = None,
    executor: Executor | None = None,
    staged: Callable[[str, float], None] | None = None,
) -> Calibration:
    """Estimate a sensor's parameters from a telemetry set, or from several as one.

    Parameters
    ----------
    telemetry, sensor, catalogue
        The data, whose they are, and where directions come from that the data do not give. A large file is never in memory.
    settings
        Method and choices.
    validation
        A set that takes no part in the estimate, to check it by.
    prior
        A former calibration of the sensor, which the run starts from with its covariance; sets that it holds are left out.
    sha256s
        Content addresses of the input files by role, kept in the result.
    report
        Told of progress, about four times a second.
    cancelled
        Asked often; True stops.
    cache_folder
        Where lost-in-space identification keeps its tables; None makes them again when they are needed.
    scratch_folder
        Where the working copy of a large file is made, in a folder that is gone at the end; None is the temporary folder.
    executor
        What computes over a large file; None is this process. It must see the scratch folder under the same path.
    staged
        Told of each stage that is over, with the seconds it took.

    Returns
    -------
    The calibration. A numeric failure is its `status` with `advice`.

    Raises
    ------
    RefusedInputError
        When the free parameters are not the sensor's, too many matched stars lie off its detector, or directions cannot be had.
    CancelledError
        When `cancelled` said so.
    """
    clock = _Timer(staged)
    context = CalibrationContext(cancelled or never, report, cache_folder, scratch_folder, executor)
    told = nullcontext() if report is None else report_waits_to(lambda message, _: report(Progress(0.0, message, None)))
    catalogue = catalogue.without(settings.leave_out_stars)
    corrections: Corrections | None = Corrections(sensor, catalogue, left_out=settings.leave_out_stars)
    with told:
        try:
            begun = _begin(telemetry, sensor, catalogue, settings, context, prior, sha256s or {})
            telemetry, sensor, parameters = begun.telemetry, begun.sensor, begun.parameters
            while corrections is not None:
                used = corrections
                with open_dataset(telemetry, sensor, catalogue, parameters, settings, context, used) as (sets, off):
                    found, ended, corrections = _calibrated(
                        sets, parameters, sets.settings, sha256s or {}, context, clock, used
                    )
                    begun = begun.with_passes_judged(None if corrections else ended)
        except OffDetectorError as error:
            from boresight.calibration.diagnosis.explain import explain_refusal  # noqa: PLC0415 - only refused sets

            raise explain_refusal(error, telemetry, sensor, catalogue, cache_folder) from error
    found = begun.describe(found, ended, settings)
    if hardly_matches(found):
        found = replace(found, advice=_explained(telemetry, sensor, catalogue, settings, context, found.advice))
        clock.lap("diagnose")
    found = with_advice(
        replace(found, stars_off_detector=_describe_off(off)), *make_advice("off_detector", off.sentences())
    )
    if validation is not None and ended is not None and ended.estimate.status != "diverged":
        judged, off = open_validation_set(validation, sensor, JUDGED_STARS)
        judged = used.apply(judged)
        chosen = choose_match_mode(judged, settings)
        found = validate(found, judged, sensor, catalogue, ended.estimate, parameters, chosen, cache_folder)
        found = with_advice(found, *make_advice("off_detector", off.sentences(" in the validation set")))
        if is_large(validation):
            frames = len(np.unique(judged.frame))
            said = f"The validation set is large: {frames:,} of its frames, evenly spread, were used."
            found = with_advice(found, Advice(said, "judged_on"))
        clock.lap("validate")
    return found if ended is None else replace(found, timing_s={**clock.laps, "method": ended.method_s})


@dataclass(frozen=True)
class _Begun:
    """What a calibration is made of once a prior and parameters of a pass are taken in, and what is told of these."""

    telemetry: TelemetryInput
    sensor: Sensor
    parameters: Parameters
    passes: TelemetryInput
    taken: TakenPrior | None = None
    variation: PassVariation | None = None
    advice: Sequence[Advice] = ()
    judged: Sequence[InputPass] = ()

    def with_passes_judged(self, ended: CyclesEnd | None) -> _Begun:
        """Say of each of several passes what of it was in the fit that ended, while its arcs are there."""
        passes = list_passes(self.passes)
        if self.judged or len(passes) < 2 or ended is None or ended.estimate.status == "diverged":
            return self
        problem, x = ended.matched.problem, ended.estimate.x
        return replace(self, judged=judge_passes(problem, passes, self.parameters, x))

    def describe(self, found: Calibration, ended: CyclesEnd | None, settings: CalibrationSettings) -> Calibration:
        """Say in a calibration which passes it had, what varied, and what came from a prior."""
        inputs = replace(found.inputs, passes=list(self.judged) or list_passes(self.passes))
        found = replace(found, inputs=inputs, variation=self.variation)
        if self.taken is None or ended is None or ended.estimate.status == "diverged":
            return found
        use = self.taken.describe(ended.matched.problem, self.parameters, settings, ended.estimate)
        return with_advice(
            replace(found, prior=use), *self.taken.advice(use, self.parameters, ended.estimate), *self.advice
        )


def _begin(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    context: CalibrationContext,
    prior: PriorSource | None,
    sha256s: Mapping[str, str],
) -> _Begun:
    """Take in a prior, and of parameters that vary what the other passes know of the last."""
    parameters = select_free_parameters(sensor, settings)
    if prior is None:
        refuse_without_prior(settings)
        if settings.vary:
            return _fit_passes(telemetry, sensor, catalogue, parameters, settings, context)
        drifting = _with_drift(telemetry, sensor, catalogue, parameters, settings, context)
        return _Begun(telemetry, sensor, drifting, telemetry)
    refuse_vary(settings)
    check_same_camera(prior, sensor)
    new, left_out = without_held(telemetry, prior, sha256s)
    taken = take_prior(prior, sensor, parameters, settings, new.begins)
    there = replace(sensor, initial=taken.prior.x)
    parameters = replace(parameters, prior=taken.prior)
    drifting = _with_drift(new, there, catalogue, parameters, settings, context)
    return _Begun(new, there, drifting, new, taken, advice=make_advice("prior", left_out))


def _with_drift(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    context: CalibrationContext,
) -> Parameters:
    """Estimate how far the parameters of a filter drift, where nobody stated it and the set shows it."""
    if not settings.drifts or settings.states_drift or not shows_drift(telemetry):
        return parameters
    with _fit_alike(telemetry, sensor, catalogue, parameters, settings, context) as ended:
        if ended.estimate.status in {"diverged", "max_iterations"}:
            return parameters
        problem, x = ended.matched.problem, ended.estimate.x
        return replace(parameters, drift=estimate_drift(problem, parameters, x, settings, context.cancelled))


def _fit_passes(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    context: CalibrationContext,
) -> _Begun:
    """Match and fit all passes as one camera, and from there with what varies: the last pass, with the others as its prior."""
    names = [CAMERA_MODELS[sensor.camera_model].parameter_names[p] for p in parameters.free]
    if not isinstance(telemetry, JointTelemetry):
        refuse_one_pass()
    check_variation(names, settings)
    with _fit_alike(telemetry, sensor, catalogue, parameters, settings, context) as ended:
        if ended.estimate.status in {"diverged", "max_iterations"}:
            raise RefusedInputError("The passes do not fit a single camera; run without --vary to see the details.")
        fitted, variation = fit_variation(
            ended.matched.problem, list_passes(telemetry), parameters, ended.estimate.x, settings, context.cancelled
        )
        judged = fitted.judge(list_passes(telemetry))
    open_sigmas = settings.initial_sigma_scale if settings.sequential else OPEN_SIGMAS
    origin = PriorUse(name="the other passes", covariance="noise", inflation=1.0)
    remedy = "let more parameters vary, and look at each pass by itself"
    taken = TakenPrior(
        fitted.prior_of_last(parameters, open_sigmas), origin, (Advice(variation.sentence, "variation"),), remedy
    )
    last = telemetry.in_order[-1].telemetry
    return _Begun(last, sensor, replace(parameters, prior=taken.prior), telemetry, taken, variation, judged=judged)


@contextmanager
def _fit_alike(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    parameters: Parameters,
    settings: CalibrationSettings,
    context: CalibrationContext,
) -> Iterator[CyclesEnd]:
    """Match and fit all frames as one camera, by least squares; what that ended with holds within."""
    usual = CalibrationSettings()
    of_filters = {name: getattr(usual, name) for name, option in OPTIONS.items() if "batch" not in option.methods}
    alike = replace(settings, **of_filters, method="batch", vary=None)
    corrections = Corrections(sensor, catalogue, left_out=settings.leave_out_stars)
    with open_dataset(telemetry, sensor, catalogue, parameters, alike, context, corrections) as (sets, _):
        first = sets.at_start()
        yield Estimation(sets, first, parameters, sets.settings, lambda *_: None, context.cancelled).run()


def hardly_matches(found: Calibration) -> bool:
    """Whether so little of a set matched that sensor file and telemetry may not fit each other."""
    if found.status in {"too_few_stars", "diverged"}:
        return True
    if found.matching is None:
        return False
    reasons = found.matching.exposure_reasons
    return 2 * reasons.get(EXPOSURE_REASONS[0], 0) < sum(reasons.values())


def _explained(
    telemetry: TelemetryInput,
    sensor: Sensor,
    catalogue: Catalogue,
    settings: CalibrationSettings,
    context: CalibrationContext,
    advice: Sequence[str],
) -> list[str]:
    """The advice on a set that hardly matches with what a diagnosis says."""
    from boresight.calibration.diagnosis.explain import explain  # noqa: PLC0415 - only for sets that hardly match

    def report(message: str, _: float | None) -> None:
        refuse_cancelled(context.cancelled, "before the reason for so few matches was found")
        if context.report is not None:
            context.report(Progress(0.0, f"finding the reason for so few matches: {message}", None))

    return explain(telemetry, sensor, catalogue, settings, context.cache_folder, report, advice=advice)


def _describe_off(off: OffDetector) -> StarsOffDetector:
    """Say which matched stars lie off the detector."""
    return StarsOffDetector(
        stars=off.stars,
        farthest_px=off.farthest_px if off.stars else None,
        rows=list(off.first),
    )


def _calibrated(
    sets: Dataset,
    parameters: Parameters,
    settings: CalibrationSettings,
    sha256s: Mapping[str, str],
    context: CalibrationContext,
    clock: _Timer,
    corrections: Corrections,
) -> tuple[Calibration, CyclesEnd | None, Corrections | None]:
    """Estimate and judge; returns where it ended too, None where there was nothing to estimate from.

    Where more of the set is to be put right than `corrections` did, nothing is judged, and that comes back last.
    """
    first = sets.at_start()
    clock.lap("arcs")
    if first.problem.arcs.n_exposures == 0:
        nothing = result.nothing_estimated(first.problem, parameters, settings, sha256s)
        if sets.is_given:
            nothing = _with_removed(nothing, sets, first)
        return nothing, None, None
    reporter = ProgressReporter(first.problem, parameters, settings, sha256s, context.report, sets.prepared)
    estimation = Estimation(sets, first, parameters, settings, reporter, context.cancelled)
    ended = estimation.run()
    while True:
        ended = replace(ended, estimate=_checked(ended.matched.problem, ended.estimate))
        clock.lap("fit")
        try:
            found = _judge(sets, first, ended, parameters, settings, sha256s, corrections, context.cancelled)
            break
        except LowerMinimum as lower:
            restarts = ended.estimate.searched.restarts + 1
            ended = replace(estimation, first=ended.matched).fit_in_cycles(lower, restarts)
    if isinstance(found, Corrections):
        return (
            result.describe_estimate(ended.matched.problem, parameters, settings, ended.estimate, sha256s),
            ended,
            found,
        )
    if sets.is_given:
        found = _with_removed(found, sets, ended.matched)
    clock.lap("judge")
    if settings.drifts:
        names = free_names(ended.matched.problem, parameters)
        found = replace(found, process_noise=describe_process_noise(names, choose_drift(parameters, names, settings)))
    if settings.smooth and ended.estimate.status != "diverged":
        of = (ended.matched.problem, parameters, settings, ended.estimate, context.cancelled)
        found = replace(found, smoothed=describe_smoothed(*of))
        clock.lap("smooth")
    return found, ended, None


@dataclass(frozen=True)
class _LastPass:
    """A set at the result of a pass: what its noise is, what it assumes, and what is still to be put right."""

    telemetry: Telemetry
    matched: Matched
    estimate: Estimate
    parameters: Parameters
    settings: CalibrationSettings
    corrections: Corrections

    @cached_property
    def noise(self) -> Noise:
        """How noise and bias depend on what is known of the stars."""
        free = FreeCovariance(self.parameters.free, self.parameters.scale, self.estimate.P)
        arcs = self.matched.problem.arcs.whole()
        return self.corrections.estimate_noise(
            self.matched.telemetry, arcs, self.estimate.x, free, to_apply=self.settings.noise_model == "from-data"
        )

    def refined(self, *, in_memory: bool) -> Corrections | None:
        """What another pass should put right."""
        star_id = self.matched.telemetry.star_id if in_memory else None
        estimate = (lambda: self.noise) if self.settings.noise_model == "from-data" else None
        return self.corrections.refined(self.estimate.x, star_id, estimate)

    def assumptions(self, trust: Trust | None) -> list[Assumption]:
        """What was assumed that the set cannot show, and that its tests may miss."""
        of, done = self.corrections, self.corrections.done
        unseen = trust.unseen if trust else ()
        return list_assumptions(
            self.telemetry, self.matched.telemetry, of.sensor, of.catalogue, self.estimate.x, done, unseen
        )


def _with_removed(found: Calibration, sets: Dataset, matched: Matched) -> Calibration:
    """Say first which proposed stars were removed: wrong ones are graver than what they would have done."""
    of = RemovedOf(proposed=sets.proposed_stars, removed=len(matched.refused))
    listed = sets.removed(matched)
    said = [*advise(of.proposed, of.removed, listed), *found.advice]
    return replace(found, removed=listed, removed_of=of, advice=said)


def _judge(
    sets: Dataset,
    first: Matched,
    ended: CyclesEnd,
    parameters: Parameters,
    settings: CalibrationSettings,
    sha256s: Mapping[str, str],
    corrections: Corrections,
    cancelled: Asked,
) -> Calibration | Corrections:
    """Describe and judge an estimate, or say what of the set is to be put right first.

    Raises LowerMinimum where judging it leads to one, so often as that is taken up.
    """
    problem, estimate = ended.matched.problem, ended.estimate
    refuse_cancelled(cancelled, "before the estimate was judged")
    of_any_number = np.errstate(over="ignore", invalid="ignore", divide="ignore")  # as a diverged state may be
    with of_any_number if estimate.status == "diverged" else nullcontext():
        found = result.describe_estimate(problem, parameters, settings, estimate, sha256s)
    if estimate.status == "diverged":
        return found
    judged = sets.judged(first, ended.matched)
    last = _LastPass(judged.sets.telemetry, judged.last, estimate, parameters, settings, corrections)
    again = last.refined(in_memory=judged.last is ended.matched)
    if again is not None:
        return again
    minima = _describe_minima(problem, parameters, settings, estimate, cancelled)
    found = with_advice(replace(found, minima=minima), *minima_advice(minima))
    last_ended = ended.judged_by(judged.last)
    found = evaluate_result(found, judged.sets, judged.first, last_ended, parameters, settings, cancelled)
    found = replace(found, noise=corrections.noise or last.noise, assumptions=last.assumptions(found.trust))
    return _say_what_was_judged(found, judged.last.problem)


def _describe_minima(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate, cancelled: Asked
) -> Minima | None:
    """Say which minima a set has, be it a batch or a filter that was run."""
    if not settings.sequential:
        return describe_minima(problem, estimate.searched, estimate.x, result.find_sigma(problem, parameters, estimate))
    of = (parameters.free, parameters.scale, estimate.x, cancelled, parameters.prior)
    return describe_minima_of_filter(problem, look_about_filter(problem, *of), estimate.x, estimate.A)


def _say_what_was_judged(found: Calibration, judged: Problem) -> Calibration:
    """Say of a set too large to be judged whole what was."""
    if judged.arcs.n_frames == found.frames:
        return found
    part = JudgedOn(frames=judged.arcs.n_frames, stars=judged.arcs.n_stars, of_frames=found.frames)
    return with_advice(
        replace(found, judged_on=part),
        Advice(
            f"The flight check, shadow mode, alignment and trust tests use {judged.arcs.n_frames:,} of {found.frames:,} frames, "
            "in stretches spread evenly over the set; estimate, sigmas, chi-square, RMS and coverage use all frames.",
            "judged_on",
        ),
    )


def select_free_parameters(sensor: Sensor, settings: CalibrationSettings) -> Parameters:
    """Places and scales of the free parameters, in parameter order."""
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    wanted = sensor.free if settings.free is None else settings.free
    for name in wanted:
        if name not in names:
            raise RefusedInputError(
                f"Parameter {name!r} is not one of the camera model {sensor.camera_model}: choose from {', '.join(names)}.",
                code="unknown-parameter",
            )
    free = np.array([place for place, name in enumerate(names) if name in wanted], dtype=np.int64)
    return Parameters(free, sensor.typical_sigma[free])


def _checked(problem: Problem, estimate: Estimate) -> Estimate:
    """Call an estimate diverged when a parameter left the range of what can be, or part of the detector has no direction."""
    return estimate if problem.can_be(estimate.x) else replace(estimate, status="diverged")


class _Timer:
    """Seconds spent, lap by lap."""

    def __init__(self, staged: Callable[[str, float], None] | None = None) -> None:
        self._last = time.perf_counter()
        self._staged = staged
        self.laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Book the time since the last lap under a name."""
        now = time.perf_counter()
        self.laps[name], self._last = now - self._last, now
        if self._staged is not None:
            self._staged(name, self.laps[name])
