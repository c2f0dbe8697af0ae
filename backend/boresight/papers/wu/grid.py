"""W's unstated settings varied in a grid: which of them come nearest to the printed criterion A.

W gives neither R nor P_0 nor Q nor the order of the stars in its combinations. The grid holds every combination of

    R        full, or diagonal (see `estimators`)
    P_0      ours, ten times ours, one of each printed unit (1, mm, px, px, 1, 1), or W Table 1's precision
    Q        q^2 diag(precision^2) a frame with the precision of W Table 1 and q = 0, 0.01, 0.03, 0.1, 1
    order    fat triangles (ours), as read out (ascending columns), or random, which an order by brightness is too

The scale of R is no fifth axis: R, P_0 and Q times a common factor change no estimate. All filters linearise a frame once,

    Lambda+ = (Lambda^-1 + Q)^-1 + G,      z+ = z - (Lambda+)^-1 g,      G = H^T R^-1 H,     g = H^T R^-1 e

and a frame's G is the same for all settings whose state lies near the truth, where g(z) = g(z_0) + G (z - z_0): so all of an order
are run at once, and rows are taken at a setting's own state only as long as that is more than `NEAR` precisions of Table 1 away.

How near a setting comes is the typical factor exp sqrt(mean ln^2(ours / printed)) over the printed means of criterion A, each once.
The deviations over images stand beside it and rank nothing: they are the same estimates seen again.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.papers.documents import Finding, compute_typical_factor, count_within_two, grid_document
from boresight.papers.wu import printed
from boresight.papers.wu.estimators import START_SIGMA, Estimator, Judges, Trial, draw_trial, estimators, measured_rows
from boresight.simulation.sensors import WU_START, WU_TRUTH, WU_TYPICAL_SIGMA

WEIGHTS = ("full", "diagonal")
P_0 = {
    "ours": START_SIGMA,
    "ten times ours": 10 * START_SIGMA,
    "one printed unit": np.array([1.0, 1e-3, 1.0, 1.0, 1.0, 1.0]),
    "Table 1": WU_TYPICAL_SIGMA,
}
Q_SIGMA = (0.0, 0.01, 0.03, 0.1, 1.0)
ORDERS = ("fat triangles", "as read out", "random")
#: Distance from the truth, in precisions of W Table 1, within which the rows of the truth serve: f within 2 um, u0 within 20 px.
NEAR = 20.0
#: The state of the truth as the filter counts it.
Z_TRUTH = (WU_TRUTH - WU_START) / START_SIGMA

Rows = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Setting:
    """One choice of what W leaves open, but for the order of the stars."""

    weights: str
    p_0: str
    q: float


SETTINGS = tuple(Setting(*one) for one in product(WEIGHTS, P_0, Q_SIGMA))


@dataclass(frozen=True)
class GridTrial:
    """A set to run the grid on, and the order of its stars."""

    trial: Trial
    order: str


def run_grid(grid: GridTrial, catalogue_folder: Path | None) -> tuple[list[dict[str, Any]], float]:
    """Run every setting on one set; returns a record with criterion A for each and each estimator, and processor seconds."""
    began, records = time.process_time(), list[dict[str, Any]]()
    for limit in printed.GROUPS:
        arcs, judges = draw_trial(grid.trial, limit, catalogue_folder)
        arcs = order_stars(arcs, grid.order, np.random.default_rng(grid.trial.index))
        for estimator in _estimators(limit, grid.order):
            states = run_settings(estimator, arcs, SETTINGS)
            records += _records(limit, grid.order, estimator.key, states, judges)
    return records, time.process_time() - began


def _estimators(limit: float, order: str) -> list[Estimator]:
    """What runs under an order: angular distances know none and run under the first."""
    return [one for one in estimators(limit) if one.weights == "full" and (one.method == "svd" or order == ORDERS[0])]


def _records(limit: float, order: str, key: str, states: FloatArray, judges: Judges) -> Iterator[dict[str, Any]]:
    for setting, x in zip(SETTINGS, states, strict=True):
        A = judges.criterion_a(x) if np.isfinite(x).all() else (np.inf, np.inf)
        yield {"setting": setting, "order": order, "place": (key, limit), "A": A}


def order_stars(arcs: ArcSet, order: str, rng: np.random.Generator) -> ArcSet:
    """Put the stars of each exposure in another order; `fat triangles` is the order that they have."""
    if order == ORDERS[0]:
        return arcs
    key = arcs.col_px if order == ORDERS[1] else rng.random(arcs.n_stars)
    exposure = np.repeat(np.arange(arcs.n_exposures), np.diff(arcs.star_start))
    turned = np.lexsort((key, exposure))
    return replace(
        arcs,
        row_px=arcs.row_px[turned],
        col_px=arcs.col_px[turned],
        sigma_px=arcs.sigma_px[turned],
        s_i=np.ascontiguousarray(arcs.s_i[turned]),
        source_row=arcs.source_row[turned],
    )


def run_settings(estimator: Estimator, arcs: ArcSet, settings: Sequence[Setting], near: float = NEAR) -> FloatArray:
    """Run filters of all settings over a set from the printed start; returns their last states (n_settings, 6), SI.

    `near`: distance from the truth within which its rows serve, precisions of W Table 1; 0 takes rows at every own state.
    """
    reference, sigma_rad = estimator.reference(), angular_sigma(PINHOLE_RADIAL, WU_TRUTH, arcs)
    r = estimator.row_sigma(arcs)
    kinds = [setting.weights for setting in settings]
    z = np.zeros((len(settings), len(START_SIGMA)))
    information = np.stack([np.diag((START_SIGMA / P_0[setting.p_0]) ** 2) for setting in settings])
    Q = np.stack([np.diag((setting.q * WU_TYPICAL_SIGMA / START_SIGMA) ** 2) for setting in settings])
    noisy = np.flatnonzero([setting.q > 0 for setting in settings])
    for k in range(arcs.n_frames):
        frame = Frame(arcs, k, sigma_rad)
        reference.whiten(frame.star_start, frame.s_i, frame.sigma_rad)
        information[noisy] = np.linalg.inv(np.linalg.inv(information[noisy]) + Q[noisy])
        G, g = _gradients(reference, frame, z, kinds, r, near)
        information += G
        z = z - np.linalg.solve(information, g[..., None])[..., 0]
    return np.asarray(WU_START + START_SIGMA * z)


def _gradients(
    reference: SingularValues | AllPairs, frame: Frame, z: FloatArray, kinds: Sequence[str], r: float, near: float
) -> Rows:
    """G (n_settings, 6, 6) and g (n_settings, 6) of a frame at the states z (n_settings, 6)."""
    away = np.abs(z - Z_TRUTH) * START_SIGMA / WU_TYPICAL_SIGMA
    own = np.flatnonzero(~(away.max(axis=1) < near)).tolist()
    at_truth = _gradient(reference, frame, WU_TRUTH, sorted(set(kinds)), r) if len(own) < len(z) else {}
    G, g = np.empty((*z.shape, z.shape[1])), np.empty_like(z)
    for weights, (slope, gradient) in at_truth.items():
        places = [place for place, kind in enumerate(kinds) if kind == weights]
        G[places], g[places] = slope, gradient + (z[places] - Z_TRUTH) @ slope
    for place in own:
        x = WU_START + START_SIGMA * z[place]
        G[place], g[place] = _gradient(reference, frame, x, [kinds[place]], r)[kinds[place]]
    return G, g


def _gradient(
    reference: SingularValues | AllPairs, frame: Frame, x: FloatArray, kinds: Sequence[str], r: float
) -> Mapping[str, Rows]:
    """H^T R^-1 H and H^T R^-1 e of a frame at parameters x, by kind of R."""
    s, D = frame.directions(x)
    found = {}
    for weights in kinds:
        e, H = reference.rows(s, D) if weights == "full" else measured_rows(reference, s, D)
        scale = 1.0 if weights == "full" else r**-2
        found[weights] = scale * H.T @ H, scale * H.T @ e
    return found


def _printed_a() -> dict[tuple[str, float], tuple[float, float]]:
    """Printed mean and deviation of criterion A by estimator and limiting magnitude, each place once."""
    models = [(f"svd-{model}-23", 5.5) for model in printed.MODELS]
    subsets = [(f"svd-4-{''.join(map(str, values))}", 5.5) for values in printed.SUBSETS]
    groups = [(key, limit) for limit in printed.GROUPS for key in ("angular", "svd-4-23")]
    compared = {which: printed.TABLE_4["A", which] for which in ("mean", "deviation")}
    tables = ((models, printed.TABLE_2_A), (subsets, printed.TABLE_3_A), (groups, compared))
    return {
        place: (mean, deviation)
        for places, table in tables
        for place, mean, deviation in zip(places, table["mean"], table["deviation"], strict=True)
    }


PRINTED_A = _printed_a()


AXES = ("R", "P₀", "Q in precisions", "order")


def grids(records: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """Write the grid of the settings that W leaves open; none where it was not run."""
    found = compare(records)
    ours = [one for one in found if [one[axis] for axis in AXES] == ["full", "ours", 0.0, ORDERS[0]]]
    about = f"the {len(PRINTED_A)} printed means of criterion A"
    return [grid_document("R, P₀, Q and the order of the stars", about, AXES, found, one) for one in ours]


def compare(records: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """Hold every setting and order against the print; of several sets the mean counts."""
    ours: dict[tuple[Setting, str], dict[tuple[str, float], list[Any]]] = {}
    once: dict[tuple[Setting, tuple[str, float]], list[Any]] = {}
    for one in records:
        if one["place"][0] == "angular":
            once.setdefault((one["setting"], one["place"]), []).append(one["A"])
        ours.setdefault((one["setting"], one["order"]), {}).setdefault(one["place"], []).append(one["A"])
    return [
        _compared(setting, order, {
            place: np.mean(places.get(place) or once[setting, place], axis=0) for place in PRINTED_A
        })
        for (setting, order), places in ours.items()
    ]  # fmt: skip


def _compared(setting: Setting, order: str, A: Mapping[tuple[str, float], FloatArray]) -> Finding:
    ratios = np.array([A[place] / np.array(theirs) for place, theirs in PRINTED_A.items()])
    return {
        **dict(zip(AXES, (setting.weights, setting.p_0, setting.q, order), strict=True)),
        "factor": compute_typical_factor(ratios[:, 0]), "within_two": count_within_two(ratios[:, 0]), "numbers": len(ratios),
        "factor_of_deviations": compute_typical_factor(ratios[:, 1]),
        "mean": {f"{key} {limit:g}": float(A[key, limit][0]) for key, limit in PRINTED_A},
    }  # fmt: skip
