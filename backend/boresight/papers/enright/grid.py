"""E's unstated settings varied in two grids: which of them come nearest to the printed rows.

E does not give the tolerance of its flight matching, Q, P_0, or how often a filter linearises a frame (its equations do so once).

Matching: the tolerance of the flight software, 5 to 15 sigmas of an arc, of all sensors that were run; held against the
availability and matched star ratio of Table IV.

Filters: of sensor 2, whose parameters are the only ones printed, every combination of

    P_0        (1, 10 typical sigmas)^2
    Q          (0.002, 0.02, 0.2 typical sigmas)^2 a frame, of Q and No-Refit
    frame      linearised once, or up to six times
    matching   by the statistical rule, or by the flight rule at 5 or 15 sigmas of an arc

held against the sequential numbers of Table V, as RMS over all arcs of the validation set, and of Table VII, as changes from the
ground calibration. Two choices are no axes: R follows from the centroid noise (Eqs 16 and 17), whose scale moves no estimate when
P_0 and Q have it too, and the order of the stars changes nothing where R is taken in full, for all 2 N - 3 arcs hold the same.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from boresight.calibration.calibrate import calibrate
from boresight.calibration.matching.flight_check import ARC_SIGMAS, compute_flight_tolerance
from boresight.calibration.problem import build_problem
from boresight.estimation.arcs import ArcSet
from boresight.estimation.metrics import arc_errors
from boresight.papers.documents import Finding, compute_typical_factor, count_within_two, grid_document
from boresight.papers.enright import printed
from boresight.papers.enright.estimators import ESTIMATORS, Trial, TrialData, draw_trial
from boresight.papers.enright.pooled import Pooled
from boresight.papers.enright.tables import NAMES, START, URAD_PER_RAD

#: The sensor whose parameters Table VII prints.
SENSOR = 2
VARIANTS = printed.ESTIMATORS[1:]
START_SIGMAS = (10.0, 1.0)
Q_SIGMAS = (0.02, 0.002, 0.2)
LINEARISATIONS = (6, 1)
#: Tolerance of the flight rule, arc sigmas; None is the statistical rule.
TOLERANCES = (None, 5.0, 15.0)


@dataclass(frozen=True)
class Setting:
    """One choice of what E leaves open; the first of each axis is ours."""

    start_sigma: float
    q_sigma: float
    linearisations: int
    arc_sigmas: float | None


SETTINGS = tuple(Setting(*one) for one in product(START_SIGMAS, Q_SIGMAS, LINEARISATIONS, TOLERANCES))
AXES = ("P₀ in typical sigmas", "Q in typical sigmas", "linearisations", "matching")
#: What a quick study runs.
FEW = tuple(one for one in SETTINGS if one.start_sigma == START_SIGMAS[0] and one.arc_sigmas is None)


@dataclass(frozen=True)
class GridTrial:
    """A set to run settings on that differ in Q alone, those of one filter setting and matching rule."""

    trial: Trial
    settings: tuple[Setting, ...]


def split(trial: Trial, settings: Sequence[Setting]) -> list[GridTrial]:
    """Put settings together that share all but Q, for No-Q is the same under them."""
    shared: dict[Setting, list[Setting]] = {}
    for setting in settings:
        shared.setdefault(replace(setting, q_sigma=0.0), []).append(setting)
    return [GridTrial(trial, tuple(some)) for some in shared.values()]


def run_grid(grid: GridTrial, catalogue_folder: Path | None) -> tuple[list[Finding], float]:
    """Run the sequential variants; returns each setting with the ratios of our numbers to the print, and processor seconds."""
    began = time.process_time()
    data = draw_trial(grid.trial, catalogue_folder)
    judges = build_problem(data.validation, data.sensor, data.catalogue).whitened(data.truth).whole()
    no_q = _compared(data, judges, "no-q", grid.settings[0])
    found = [
        _record(setting, {
            "q": _compared(data, judges, "q", setting), "no-q": no_q,
            "no-refit": _compared(data, judges, "no-refit", setting),
        })
        for setting in grid.settings
    ]  # fmt: skip
    return found, time.process_time() - began


def _record(setting: Setting, ratios: dict[str, list[float]]) -> Finding:
    found = np.array(list(ratios.values()))
    matching = "statistical" if setting.arc_sigmas is None else f"flight, {setting.arc_sigmas:g} arc sigmas"
    return {
        **dict(zip(AXES, (setting.start_sigma, setting.q_sigma, setting.linearisations, matching), strict=True)),
        "factor": compute_typical_factor(found), "factor_of_rms": compute_typical_factor(found[:, 0]),
        "within_two": count_within_two(found), "numbers": found.size, "ratios": ratios,
    }  # fmt: skip


def _compared(data: TrialData, judges: ArcSet, variant: str, setting: Setting) -> list[float]:
    """Ratios of ours to the print: RMS on the validation set, and the changes of f, b4 and b2; NaN where there is no estimate."""
    settings = replace(
        ESTIMATORS[variant].settings, initial_sigma_scale=setting.start_sigma, process_noise_sigma=setting.q_sigma,
        linearisations=setting.linearisations,
    )  # fmt: skip
    if setting.arc_sigmas is not None:
        tolerance = setting.arc_sigmas / ARC_SIGMAS * compute_flight_tolerance(data.sensor, settings) * URAD_PER_RAD
        settings = replace(settings, match_rule="flight", flight_tolerance_urad=tolerance)
    x = calibrate(data.calibration, data.sensor, data.catalogue, settings).to_dict()["parameters"]
    place = printed.ESTIMATORS.index(variant)
    rms = np.sqrt(np.mean(arc_errors(judges, np.array([x[name] for name in NAMES])) ** 2)) * URAD_PER_RAD
    return [float(rms) / printed.TABLE_V[str(SENSOR)][1 + place], *_change_ratios(x, place)]


def _change_ratios(x: dict[str, float], place: int) -> Iterator[float]:
    for name, values in printed.TABLE_VII.items():
        unit = printed.TABLE_VII_UNITS[name][0]
        yield (x[name] - START[name]) / (values[place] * unit - START[name])


def grids(pooled: Pooled, varied: Sequence[Finding]) -> list[Finding]:
    """Write both grids; that of the filters where it was run."""
    tolerances = compare_tolerances(pooled)
    made = [grid_document(
        "The tolerance of the flight matching", "availability and matched star ratio of Table IV", ("arc sigmas",), tolerances,
        next(one for one in tolerances if one["arc sigmas"] == ARC_SIGMAS),
    )]  # fmt: skip
    if varied:
        about = "the sequential numbers of Tables V and VII for sensor 2"
        made.append(grid_document("P₀, Q, linearisations and matching of the filters", about, AXES, varied, varied[0]))
    return made


def compare_tolerances(pooled: Pooled) -> list[Finding]:
    """Hold every tolerance of the flight software against Table IV."""
    records, found = pooled.firsts("batch"), []
    for place, tried in enumerate(records[0]["tolerances"]):
        ratios = np.array([_at_tolerance(record["sensor"], record["tolerances"][place]) for record in records])
        found.append({
            "arc sigmas": tried["arc_sigmas"], "tolerance_urad": tried["flight_tolerance_rad"] * URAD_PER_RAD,
            "factor": compute_typical_factor(ratios), "within_two": count_within_two(ratios), "numbers": ratios.size,
        })  # fmt: skip
    return found


def _at_tolerance(sensor: int, tried: dict[str, Any]) -> list[float]:
    """Ratios of ours to the print: availability initial and final, matched star ratio."""
    seen = tried["availability"]
    ours = (seen["initial"], seen["final"], tried["matched_star_ratio"])
    return [np.nan if one is None else one / value for one, value in zip(ours, printed.TABLE_IV[sensor], strict=False)]
