"""An estimate put into the form of a calibration: every number beside how far it can be trusted.

For a trend over the mission the parameters are kept with their full covariance, made honest: a test of drift is as good as the
covariances it is given, and a covariance that is too small cries wolf. So variances are multiplied by the largest of

- chi-square per degree of freedom, where it is above its 95 % bound: the residuals are larger than the stated noise;
- a filter's normalised innovations per degree of freedom, where they are above theirs;
- the Cramer-Rao bound over the claim, squared, over all directions, where a claim is below what the centroids allow,

and what no factor makes comparable takes no part, with the reason: filters whose estimate is of their last frames only, or
whose matches were held to another set's parameters, or that linearise once a frame (see `estimation.filters.square_root`).

What the figures draw is computed once with the result: histories, the batch's trace, the radial difference, coverage.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import erfa
import numba
import numpy as np
import scipy
from numpy.typing import NDArray

from boresight import __version__
from boresight.arrays import ARCSEC_PER_RAD, FloatArray, IntArray, known_or_none, list_known
from boresight.calibration.advice import advice, too_few
from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import (
    Calibration,
    Change,
    ChiSquareTest,
    Covariance,
    Coverage,
    Displacement,
    History,
    HistoryBetween,
    InnovationTest,
    Inputs,
    Iterations,
    Matrix,
    Observability,
    RadialDifference,
    StarCounts,
    Status,
    Values,
    WeakestDirection,
)
from boresight.calibration.estimate import Estimate, Parameters, robust_view
from boresight.calibration.history_recorder import RecordedHistory
from boresight.calibration.options import CalibrationSettings, StatedSettings
from boresight.calibration.problem import Problem
from boresight.calibration.telemetry_pieces import pick_blocks
from boresight.calibration.trust.advice import TOO_SMALL
from boresight.estimation.arcs import ArcSet
from boresight.estimation.batch import sigma_in_scale
from boresight.estimation.blocks import FRAMES
from boresight.estimation.metrics import sums_of_squares, tail_rms
from boresight.estimation.statistics.consistency import ChiSquare, chi_square
from boresight.estimation.statistics.observability import Observability as Observed
from boresight.estimation.statistics.observability import chi2_rise, is_curved, observability
from boresight.estimation.statistics.uncertainty import displacement_px, radial_difference
from boresight.estimation.stored_arcs import Arcs

#: A calibration JSON as it is read.
Result = Mapping[str, Any]
#: Tail RMS costs one pass over the set a point; a history keeps as many points as this many frame passes allow.
TAIL_BUDGET = 4_000_000
FEWEST_POINTS, MOST_POINTS = 100, 1000
#: Frames beyond which the fewest points would cost more than that: tail RMS is then over evenly spread blocks of the set.
TAIL_WHOLE = TAIL_BUDGET // FEWEST_POINTS
RADII = 61
COVERAGE_ROWS, COVERAGE_COLUMNS = 12, 16


def _list(values: NDArray[Any]) -> list[Any]:
    return [_list(row) if row.ndim else (row.item() if np.isfinite(row) else None) for row in np.asarray(values)]


def kept_points(n_updates: int, n_frames: int) -> IntArray:
    """Which updates a history keeps: all where that is affordable, else evenly spaced with the first and the last."""
    most = int(np.clip(TAIL_BUDGET // max(n_frames, 1), FEWEST_POINTS, MOST_POINTS))
    if n_frames > TAIL_WHOLE:
        most = MOST_POINTS
    if n_updates <= most:
        return np.arange(n_updates)
    return np.unique(np.linspace(0, n_updates - 1, most).round().astype(np.int64))


def history_view(problem: Problem, parameters: Parameters, estimate: Estimate, arcs: Arcs) -> History | None:
    """A filter's history: state, sigma, tail and aggregate RMS, innovations; None for the batch."""
    history = estimate.history
    if not history:
        return None
    places = kept_points(len(history), arcs.n_frames)
    kept = history.taken(places)
    sigma = np.full(kept["states"].shape, np.nan)
    sigma[:, parameters.free] = kept["sigmas"] * parameters.scale
    return History(
        frame=_list(kept["frame"]),
        time_utc=written_times(problem, kept["frame"]),
        parameters=_list(kept["states"]),
        sigma=_list(sigma),
        tail_rms_rad=_list(_tail(arcs, np.ascontiguousarray(kept["states"]))),
        aggregate_rms_rad=_list(kept["aggregate_rms"]),
        nis=_list(kept["nis"]),
        nis_dof=_list(kept["dof"]),
        linearisations=_list(kept["linearisations"]),
        between=None if len(places) == len(history) else _between(history, places),
    )


def written_times(problem: Problem, frame: IntArray) -> list[str | None] | None:
    """Write the times of frames (n,); None where the set has none."""
    times = problem.get_times(frame)
    return None if times is None else [None if np.isnat(value) else f"{value}Z" for value in times]


def _between(history: RecordedHistory, places: IntArray) -> HistoryBetween:
    """What the updates that are not kept would have shown, for the interval that each kept one ends."""
    peaks = history.peaks(places)
    return HistoryBetween(
        nis_peak=_list(peaks.nis),
        nis_peak_dof=_list(peaks.dof),
        nis_peak_frame=_list(peaks.frame),
        parameters_low=_list(peaks.low),
        parameters_high=_list(peaks.high),
    )


def _tail(arcs: Arcs, states: FloatArray) -> FloatArray:
    """Tail RMS at each state, over the whole set or, of a very large one, over evenly spread blocks."""
    if arcs.n_frames <= TAIL_WHOLE:
        return tail_rms(arcs, states)
    chosen = pick_blocks(-(-arcs.n_frames // FRAMES), TAIL_BUDGET // MOST_POINTS // FRAMES)
    total, n_arcs = np.zeros(len(states)), 0
    for block in chosen * FRAMES:
        part = arcs.frames(block, min(block + FRAMES, arcs.n_frames))
        total += sums_of_squares(part, states)
        n_arcs += part.n_arcs
    return np.asarray(np.sqrt(total / n_arcs))


def trace_view(parameters: Parameters, estimate: Estimate, n_arcs: int, problem: Problem) -> Iterations | None:
    """The batch's iterates; None for a filter."""
    if not estimate.steps:
        return None
    sigma = np.full((len(estimate.steps), len(problem.camera.parameter_names)), np.nan)
    sigma[:, parameters.free] = np.array([step.sigma for step in estimate.steps]) * parameters.scale
    squares = np.array([step.sum_of_squares for step in estimate.steps])
    return Iterations(
        iteration=list(range(len(estimate.steps))),
        parameters=_list(np.array([step.x for step in estimate.steps])),
        sigma=_list(sigma),
        cost=_list(np.array([step.chi2 / 2 for step in estimate.steps])),
        damping=_list(np.array([step.damping for step in estimate.steps])),
        rms_arc_rad=_list(np.sqrt(squares / n_arcs)),
    )


def radial_view(
    problem: Problem, parameters: Parameters, estimate: Estimate, sigma: FloatArray
) -> RadialDifference | None:
    """Radial displacement of the estimate against its start, one-sigma, and where the data are (E Figure 5)."""
    sensor, camera = problem.sensor, problem.camera
    if not np.isfinite(estimate.x).all():
        return None
    row_0, col_0 = camera.principal_point(estimate.x)
    rows, columns = np.array([0, sensor.rows - 1.0]), np.array([0, sensor.columns - 1.0])
    corner = float(np.hypot(np.abs(rows - row_0).max(), np.abs(columns - col_0).max()))
    radius = np.linspace(0, corner, RADII)
    P = np.nan_to_num(parameters.full_covariance(estimate.P, n=len(sigma)))
    curve = radial_difference(camera, estimate.x, sensor.initial, P, radius, sensor.pixel_pitch_m)
    edges = np.linspace(0, corner, 25)
    seen = problem.arcs.over_blocks(_reach_in_block, row_0, col_0, edges)
    return RadialDifference(
        radius_px=_list(curve.radius_px),
        difference_px=_list(curve.difference_px),
        sigma_px=_list(curve.sigma_px),
        difference_arcsec=_list(curve.difference_rad * ARCSEC_PER_RAD),
        sigma_arcsec=_list(curve.sigma_rad * ARCSEC_PER_RAD),
        displacement_px=Displacement(
            initial=_list(displacement_px(camera, sensor.initial, sensor.initial, radius, sensor.pixel_pitch_m)),
            final=_list(displacement_px(camera, estimate.x, sensor.initial, radius, sensor.pixel_pitch_m)),
        ),
        data_radius_px=max(farthest for farthest, _ in seen),
        counts=StarCounts(edges_px=_list(edges), stars=np.sum([counts for _, counts in seen], axis=0).tolist()),
    )


def _reach_in_block(block: ArcSet, row_0: float, col_0: float, edges: FloatArray) -> tuple[float, IntArray]:
    """Largest distance of a star of one block from the principal point, and how many are between the edges, pixels."""
    reach = np.hypot(block.row_px - row_0, block.col_px - col_0)
    return float(reach.max()), np.histogram(reach, edges)[0]


def coverage_view(problem: Problem) -> Coverage:
    """Star counts over the detector."""
    sensor = problem.sensor
    row_edges = np.linspace(-0.5, sensor.rows - 0.5, COVERAGE_ROWS + 1)
    col_edges = np.linspace(-0.5, sensor.columns - 0.5, COVERAGE_COLUMNS + 1)
    counts = np.sum(problem.arcs.over_blocks(_counts_in_block, row_edges, col_edges), axis=0)
    return Coverage(row_edges_px=_list(row_edges), col_edges_px=_list(col_edges), counts=counts.tolist())


def _counts_in_block(block: ArcSet, row_edges: FloatArray, col_edges: FloatArray) -> IntArray:
    """Stars of one block in the cells between the edges."""
    counts, _, _ = np.histogram2d(block.row_px, block.col_px, bins=(row_edges, col_edges))
    return counts.astype(np.int64)


def numbers(values: FloatArray) -> list[Any]:
    """Turn an array into nested lists with null for what is not finite."""
    if values.ndim > 1:
        return [numbers(row) for row in values]
    return list_known(values)


def begin_calibration(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    sha256s: Mapping[str, str],
    status: Status,
) -> Calibration:
    """Say everything that is known before estimating."""
    sensor, camera = problem.sensor, problem.camera
    names = camera.parameter_names
    return Calibration(
        sensor=sensor.name,
        method=settings.method,
        variant=settings.variant if settings.sequential else None,
        camera_model=camera.name,
        parameter_names=list(names),  # a store may sort the keys of the objects below
        free=[names[p] for p in parameters.free],
        initial=_values(names, sensor.initial),
        typical_sigma=_values(names, sensor.typical_sigma),
        units=dict(zip(names, camera.units, strict=True)),
        symbols=dict(zip(names, camera.symbols, strict=True)),
        frames=problem.arcs.n_frames,
        exposures=problem.arcs.n_exposures,
        stars=problem.arcs.n_stars,
        pairs=2 * problem.arcs.n_stars - 3 * problem.arcs.n_exposures,
        frames_in_set=problem.frames_in_set,
        left_out=list(problem.left_out),
        inputs=Inputs(sha256s=dict(sha256s), versions=dict(versions()), settings=StatedSettings.of(settings)),
        status=status,
    )


def _values(names: Sequence[str], numbers_of: FloatArray) -> Values[Any]:
    """Put numbers beside the names of parameters; what is not finite is unknown."""
    return Values(dict(zip(names, numbers(numbers_of), strict=True)))


@cache
def versions() -> dict[str, str]:
    """What computes here, as the libraries themselves say: asking for installed packages takes as long as a short fit."""
    return {
        "numpy": np.__version__,
        "numba": numba.__version__,
        "scipy": scipy.__version__,
        "pyerfa": erfa.__version__,
    } | {
        "boresight": __version__,
        "python": platform.python_version(),
    }


def describe_estimate(
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    sha256s: Mapping[str, str],
) -> Calibration:
    """Put an estimate, finished or on its way, into the form of a calibration; what judges it is not in it yet."""
    arcs = problem.whitened(estimate.x)
    initial, final = tail_rms(arcs, np.stack([problem.sensor.initial, estimate.x]))
    sigma = find_sigma(problem, parameters, estimate)
    names = problem.camera.parameter_names
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = (estimate.x - problem.sensor.initial) / sigma
    estimated = replace(
        begin_calibration(problem, parameters, settings, sha256s, estimate.status),
        parameters=_values(names, estimate.x),
        sigma=_values(names, sigma),
        delta_over_sigma=_values(names, shift),
        covariance=_describe_covariance(problem, parameters, estimate, sigma),
        iterations=estimate.iterations,
        rms_arc_rad=Change(initial=float(initial), final=known_or_none(float(final))),
        robust=None if estimate.robust is None else robust_view(estimate.robust, names, sigma),
        history=history_view(problem, parameters, estimate, arcs),
        trace=trace_view(parameters, estimate, arcs.n_arcs, problem),
        radial=radial_view(problem, parameters, estimate, sigma),
        coverage=coverage_view(problem),
    )
    return _judged(estimated, problem, parameters, settings, estimate, arcs)


def find_sigma(problem: Problem, parameters: Parameters, estimate: Estimate) -> FloatArray:
    """(n_parameters,) one-sigma in SI, NaN where not estimated or not determined."""
    sigma = np.full(len(problem.camera.parameter_names), np.nan)
    in_scale = np.sqrt(np.diag(estimate.P))
    if np.isfinite(estimate.A).all():
        in_scale = np.where(np.isfinite(sigma_in_scale(parameters.with_prior(estimate.A))), in_scale, np.nan)
    sigma[parameters.free] = np.where(estimate.status == "diverged", np.nan, parameters.scale * in_scale)
    return sigma


def _describe_covariance(problem: Problem, parameters: Parameters, estimate: Estimate, sigma: FloatArray) -> Covariance:
    """Covariance of the parameters whose sigma is known."""
    known = np.isfinite(sigma[parameters.free])
    P = parameters.covariance(estimate.P)
    names = [problem.camera.parameter_names[p] for p in parameters.free[known]]
    return Covariance(names=names, matrix=numbers(P[np.ix_(known, known)]))


def _judged(
    estimated: Calibration,
    problem: Problem,
    parameters: Parameters,
    settings: CalibrationSettings,
    estimate: Estimate,
    arcs: Arcs,
) -> Calibration:
    """Add chi-square, innovations, observability and advice; none of them while the estimate is on its way."""
    dof = arcs.n_arcs - _fitted_directions(parameters, estimate)
    if estimate.status == "running" or not np.isfinite(estimate.A).all() or dof <= 0:
        return replace(estimated, nis=_innovations_so_far(estimate), advice=[*_unjudged(estimate, dof)])
    fit = chi_square(estimate.chi2, dof)
    nis = _innovations(estimate) or fit
    names = [problem.camera.parameter_names[p] for p in parameters.free]
    symbols = [problem.camera.symbols[p] for p in parameters.free]
    observed = observability(estimate.A, tuple(names), tuple(symbols))
    known = observability(parameters.with_prior(estimate.A), tuple(names), tuple(symbols))
    rise = None
    if parameters.prior is None and not settings.sequential and estimate.status != "diverged":
        rise = chi2_rise(arcs, estimate.x, parameters.free, parameters.scale, estimate.A)
    return replace(
        estimated,
        chi2_per_dof=fit.mean,
        chi2=ChiSquareTest(value=estimate.chi2, **_bounds(fit)),
        nis=InnovationTest(mean=nis.mean, **_bounds(nis)),
        observability=replace(observability_view(observed), chi2_rise=rise),
        advice=[*advice(problem, parameters, settings, estimate, fit, nis, known, rise)],
    )


def _fitted_directions(parameters: Parameters, estimate: Estimate) -> int:
    """By how much the mean of the data's chi-square lies below their number: the trace of P A, beside a prior below n_free."""
    if parameters.prior is None or not np.isfinite(estimate.A).all():
        return len(parameters.free)
    return round(float(np.trace(np.linalg.solve(parameters.with_prior(estimate.A), estimate.A))))


def observability_view(observed: Observed) -> Observability:
    """Say how well each direction of the parameters is known."""
    weakest = len(observed.names) - 1
    return Observability(
        parameter_names=list(observed.names),
        singular_values=numbers(observed.singular_values),
        condition_number=observed.condition_number,
        right_singular_vectors=numbers(observed.V.T),
        sigma_of_direction=numbers(observed.sigma_of_direction),
        weakest=WeakestDirection(direction=Values(observed.direction(weakest)), sentence=observed.sentence(weakest)),
    )


def _unjudged(estimate: Estimate, dof: int) -> list[Advice]:
    """Advice where statistics cannot be had."""
    if estimate.status == "running":
        return []
    if dof <= 0:
        none = "There are no more arcs than free parameters, so nothing can be checked: add frames or free fewer parameters."
        return [Advice(none, "too_few_arcs")]
    diverged = "The fit diverged: do not use these results; free fewer parameters, or start closer to the true values."
    return [*estimate.remarks, Advice(diverged, "diverged")]


def _bounds(test: ChiSquare) -> dict[str, Any]:
    """What a chi-square test holds besides its value."""
    return {"dof": test.dof, "lower": test.lower, "upper": test.upper, "consistent": test.consistent}


def _innovations(estimate: Estimate) -> ChiSquare | None:
    """A filter's normalised innovations per degree of freedom; None of the batch, and where every one was left out."""
    if not estimate.history or not estimate.history.dof_sum:
        return None
    return chi_square(estimate.history.nis_sum, estimate.history.dof_sum)


def _innovations_so_far(estimate: Estimate) -> InnovationTest | None:
    """The same while a filter is on its way."""
    test = _innovations(estimate)
    return None if test is None or not np.isfinite(test.mean) else InnovationTest(mean=test.mean, **_bounds(test))


def nothing_estimated(
    problem: Problem, parameters: Parameters, settings: CalibrationSettings, sha256s: Mapping[str, str]
) -> Calibration:
    """Describe a set with too few stars everywhere: the start's values, no sigma, and why."""
    names = problem.camera.parameter_names
    unknown = Values(dict.fromkeys(names))
    return replace(
        begin_calibration(problem, parameters, settings, sha256s, "too_few_stars"),
        parameters=_values(names, problem.sensor.initial),
        sigma=unknown,
        delta_over_sigma=unknown,
        advice=[*too_few(problem, settings.minimum_stars)],
    )


LEFT_OUT_VARIANTS = {
    "q": "with process noise it reflects mainly its last frames",
    "no-refit": "its matches used only the parameters that it started from",
}


OF_SEVERAL = "it combines several telemetry sets whose stars are also in other entries"
ON_A_PRIOR = "it uses a prior, and therefore telemetry of earlier entries"


@dataclass(frozen=True)
class TrendEntry:
    """What a trend over the mission keeps of a calibration.

    `names`: the k estimated parameters. `parameters`: all. `covariance`: (k, k), SI, with `variance_factor` in it. `said`: a
    sentence on that factor; None where it is one. `left_out`: why it takes no part in tests; None where it does.
    """

    camera_model: str = ""
    names: list[str] = field(default_factory=list)
    parameters: Values[float | None] = field(default_factory=Values)
    covariance: Matrix = field(default_factory=list)
    variance_factor: float = 1.0
    said: str | None = None
    left_out: str | None = None


def trend_entry(result: Calibration) -> TrendEntry | None:
    """Return what a trend keeps; None where nothing was estimated."""
    if not result.covariance.names:
        return None
    factors = dict(_factors(result))
    said = max(factors, key=lambda sentence: factors[sentence], default=None)
    factor = 1.0 if said is None else factors[said]
    return TrendEntry(
        camera_model=result.camera_model,
        names=list(result.covariance.names),
        parameters=result.parameters,
        covariance=[
            [None if one is None else one * factor for one in row] for row in result.reliable_covariance.matrix
        ],
        variance_factor=factor,
        said=said,
        left_out=_left_out(result),
    )


def _factors(result: Calibration) -> Iterator[tuple[str, float]]:
    """Yield why variances must be larger, and by how much; with misfit they have chi-square in them already."""
    chi2, nis, per_dof = result.chi2, result.nis, result.chi2_per_dof
    if result.misfit is not None:
        chi2 = None
    if per_dof is not None and chi2 is not None and chi2.upper is not None and per_dof > chi2.upper:
        yield f"sigmas multiplied by {per_dof**0.5:.2f}: chi-square is {per_dof:.3g} per degree of freedom", per_dof
    if result.misfit is not None and result.method == "batch":
        nis = None  # a batch has its chi-square there
    if nis is not None and nis.mean is not None and nis.upper is not None and nis.mean > nis.upper:
        yield f"sigmas multiplied by {nis.mean**0.5:.2f}: the normalised innovations are {nis.mean:.3g}", nis.mean
    efficiency = None if result.trust is None else result.trust.efficiency
    if efficiency is not None and 0 < efficiency.overall_ratio < TOO_SMALL:
        ratio = efficiency.overall_ratio
        yield f"sigmas multiplied by {1 / ratio:.2f}: they were below the Cramér-Rao bound", ratio**-2


def _left_out(result: Calibration) -> str | None:
    """Say why an estimate takes no part in tests; None where it does."""
    settings = result.inputs.settings
    if not result.is_usable:
        return f"it ended {result.status.replace('_', ' ')}"
    if result.observability is not None and is_curved(result.observability.chi2_rise):
        return "the fit is not linear along its weakest direction, where its covariance is wrong"
    if result.variant in LEFT_OUT_VARIANTS:
        return LEFT_OUT_VARIANTS[result.variant]
    if result.variant is not None and settings.linearisations == 1:
        return "one linearisation per frame makes it over-confident"
    if settings.forgetting_factor < 1.0:
        return "with a forgetting factor it reflects mainly its last frames"
    several = OF_SEVERAL if len(result.inputs.passes) > 1 else None
    return several if result.prior is None else ON_A_PRIOR
