"""What the figures draw, computed once with the result: histories, the batch's trace, the radial difference, coverage."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.history_recorder import FilterCourse
from boresight.calibration.problem import Problem
from boresight.calibration.streaming.sample import spread_blocks
from boresight.estimation.arcs import ArcSet
from boresight.estimation.blocks import FRAMES
from boresight.estimation.metrics import sums_of_squares, tail_rms
from boresight.estimation.statistics.uncertainty import displacement_px, radial_difference
from boresight.estimation.stored_arcs import Arcs

#: Tail RMS costs one pass over the set a point; a history keeps as many points as this many frame passes allow.
TAIL_BUDGET = 4_000_000
FEWEST_POINTS, MOST_POINTS = 100, 1000
#: Frames beyond which the fewest points would cost more than that: tail RMS is then over evenly spread blocks of the set.
TAIL_WHOLE = TAIL_BUDGET // FEWEST_POINTS
RADII = 61
COVERAGE_ROWS, COVERAGE_COLUMNS = 12, 16
ARCSEC = np.degrees(1.0) * 3600


def _list(values: NDArray[Any]) -> list[Any]:
    """Nested lists with null for what is not finite."""
    return [_list(row) if row.ndim else (row.item() if np.isfinite(row) else None) for row in np.asarray(values)]


def kept_points(n_updates: int, n_frames: int) -> IntArray:
    """Which updates a history keeps: all where that is affordable, else evenly spaced with the first and the last."""
    most = int(np.clip(TAIL_BUDGET // max(n_frames, 1), FEWEST_POINTS, MOST_POINTS))
    if n_frames > TAIL_WHOLE:
        most = MOST_POINTS
    if n_updates <= most:
        return np.arange(n_updates)
    return np.unique(np.linspace(0, n_updates - 1, most).round().astype(np.int64))


def history_view(problem: Problem, parameters: Parameters, estimate: Estimate, arcs: Arcs) -> dict[str, Any] | None:
    """A filter's history: state, sigma, tail and aggregate RMS, innovations; None for the batch."""
    history = estimate.history
    if not history:
        return None
    places = kept_points(len(history), arcs.n_frames)
    kept = history.taken(places)
    sigma = np.full(kept["states"].shape, np.nan)
    sigma[:, parameters.free] = kept["sigmas"] * parameters.scale
    times = problem.get_times(kept["frame"])
    return {
        "frame": _list(kept["frame"]),
        "time_utc": None if times is None else [None if np.isnat(value) else f"{value}Z" for value in times],
        "parameters": _list(kept["states"]),
        "sigma": _list(sigma),
        "tail_rms_rad": _list(_tail(arcs, np.ascontiguousarray(kept["states"]))),
        "aggregate_rms_rad": _list(kept["aggregate_rms"]),
        "nis": _list(kept["nis"]),
        "nis_dof": _list(kept["dof"]),
        "linearisations": _list(kept["linearisations"]),
        "between": None if len(places) == len(history) else _between(history, places),
    }


def _between(history: FilterCourse, places: IntArray) -> dict[str, Any]:
    """What the updates that are not kept would have shown, for the interval that each kept one ends."""
    peaks = history.peaks(places)
    return {
        "nis_peak": _list(peaks.nis),
        "nis_peak_dof": _list(peaks.dof),
        "nis_peak_frame": _list(peaks.frame),
        "parameters_low": _list(peaks.low),
        "parameters_high": _list(peaks.high),
    }


def _tail(arcs: Arcs, states: FloatArray) -> FloatArray:
    """Tail RMS at each state, over the whole set or, of a very large one, over evenly spread blocks."""
    if arcs.n_frames <= TAIL_WHOLE:
        return tail_rms(arcs, states)
    chosen = spread_blocks(-(-arcs.n_frames // FRAMES), TAIL_BUDGET // MOST_POINTS // FRAMES)
    total, n_arcs = np.zeros(len(states)), 0
    for block in chosen * FRAMES:
        part = arcs.frames(block, min(block + FRAMES, arcs.n_frames))
        total += sums_of_squares(part, states)
        n_arcs += part.n_arcs
    return np.asarray(np.sqrt(total / n_arcs))


def trace_view(parameters: Parameters, estimate: Estimate, n_arcs: int, problem: Problem) -> dict[str, Any] | None:
    """The batch's iterates; None for a filter."""
    if not estimate.steps:
        return None
    sigma = np.full((len(estimate.steps), len(problem.camera.parameter_names)), np.nan)
    sigma[:, parameters.free] = np.array([step.sigma for step in estimate.steps]) * parameters.scale
    squares = np.array([step.sum_of_squares for step in estimate.steps])
    return {
        "iteration": list(range(len(estimate.steps))),
        "parameters": _list(np.array([step.x for step in estimate.steps])),
        "sigma": _list(sigma),
        "cost": _list(np.array([step.chi2 / 2 for step in estimate.steps])),
        "damping": _list(np.array([step.damping for step in estimate.steps])),
        "rms_arc_rad": _list(np.sqrt(squares / n_arcs)),
    }


def radial_view(
    problem: Problem, parameters: Parameters, estimate: Estimate, sigma: FloatArray
) -> dict[str, Any] | None:
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
    return {
        "radius_px": _list(curve.radius_px),
        "difference_px": _list(curve.difference_px),
        "sigma_px": _list(curve.sigma_px),
        "difference_arcsec": _list(curve.difference_rad * ARCSEC),
        "sigma_arcsec": _list(curve.sigma_rad * ARCSEC),
        "displacement_px": {
            "initial": _list(displacement_px(camera, sensor.initial, sensor.initial, radius, sensor.pixel_pitch_m)),
            "final": _list(displacement_px(camera, estimate.x, sensor.initial, radius, sensor.pixel_pitch_m)),
        },
        "data_radius_px": max(farthest for farthest, _ in seen),
        "counts": {"edges_px": _list(edges), "stars": np.sum([counts for _, counts in seen], axis=0).tolist()},
    }


def _reach_in_block(block: ArcSet, row_0: float, col_0: float, edges: FloatArray) -> tuple[float, IntArray]:
    """Largest distance of a star of one block from the principal point, and how many are between the edges, pixels."""
    reach = np.hypot(block.row_px - row_0, block.col_px - col_0)
    return float(reach.max()), np.histogram(reach, edges)[0]


def coverage_view(problem: Problem) -> dict[str, Any]:
    """Star counts over the detector."""
    sensor = problem.sensor
    row_edges = np.linspace(-0.5, sensor.rows - 0.5, COVERAGE_ROWS + 1)
    col_edges = np.linspace(-0.5, sensor.columns - 0.5, COVERAGE_COLUMNS + 1)
    counts = np.sum(problem.arcs.over_blocks(_counts_in_block, row_edges, col_edges), axis=0)
    return {"row_edges_px": _list(row_edges), "col_edges_px": _list(col_edges), "counts": counts.tolist()}


def _counts_in_block(block: ArcSet, row_edges: FloatArray, col_edges: FloatArray) -> IntArray:
    """Stars of one block in the cells between the edges."""
    counts, _, _ = np.histogram2d(block.row_px, block.col_px, bins=(row_edges, col_edges))
    return counts.astype(np.int64)
