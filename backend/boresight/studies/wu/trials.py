"""One simulated set of each group at each centroid noise, every estimator run on it and judged.

A group's star fields are the same at both noises, and so is the noise in units of its deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation import arcs as arcsets
from boresight.estimation.arcs import ArcSet
from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.consistency import nees
from boresight.estimation.references import (
    View,
    observability_of_models,
    observability_of_values,
    weighted_information,
    whitened_information,
)
from boresight.estimation.singular_values import CHOSEN
from boresight.simulation.fields import StarFields, directions, random_fields
from boresight.simulation.sensors import (
    WU_IMPLIED_SIGMA_PX,
    WU_PIXEL_PITCH_M,
    WU_START,
    WU_STATED_SIGMA_PX,
    WU_TRUTH,
    WU_TYPICAL_SIGMA,
    wu_sensor,
)
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.studies.wu import printed
from boresight.studies.wu.criteria import Judges
from boresight.studies.wu.estimators import FREE, START_SIGMA, Run, estimators

Record = dict[str, Any]

NOISES_PX = (WU_IMPLIED_SIGMA_PX, WU_STATED_SIGMA_PX)
#: Boresights lie so near the Galactic plane, where Hipparcos shows about as many stars as the paper's images hold.
GALACTIC_LATITUDE_DEG = 25.0
#: Places along a run at which the first set is judged, for the figures.
CHECKPOINTS = 40


@dataclass(frozen=True)
class Trial:
    """One set to run: its number, and the images that calibrate and that judge."""

    index: int
    frames: int
    judges: int


def run_trial(trial: Trial, catalogue_folder: Path | None) -> list[Record]:
    """Run every estimator on one set of each group; returns one record each."""
    records = []
    for group, limit in enumerate(printed.GROUPS):
        seeds = np.random.SeedSequence([trial.index, group]).spawn(2)
        rng = np.random.default_rng(seeds[0])
        fields, judged = (fields_of(limit, n, rng, catalogue_folder) for n in (trial.frames, trial.judges))
        for noise_px in NOISES_PX:
            noise = np.random.default_rng(seeds[1])
            arcs, judges = noisy(fields, noise_px, noise), Judges.of(judged, noise_px, noise)
            head = {"set": trial.index, "magnitude_limit": limit, "noise_px": noise_px, "stars": fields.stars_per_field}
            records += _judged(head, arcs, judges)
    return records


def fields_of(limit: float, n_fields: int, rng: np.random.Generator, catalogue_folder: Path | None) -> StarFields:
    """Draw star fields of a group."""
    s_i = directions(_catalogue(catalogue_folder).brighter_than(limit))
    return random_fields(wu_sensor(), WU_TRUTH, s_i, n_fields, rng, galactic_latitude_deg=GALACTIC_LATITUDE_DEG)


@cache
def _catalogue(folder: Path | None) -> Catalogue:
    return load_catalogue(folder, max(printed.GROUPS))


def noisy(fields: StarFields, sigma_px: float, rng: np.random.Generator) -> ArcSet:
    """Add noise to star fields, order their stars and weigh them at the printed start."""
    n = len(fields.row_px)
    noise = sigma_px * rng.normal(size=(2, n))
    places, _ = arcsets.order(fields.star_start, fields.s_i)
    arcs = ArcSet(
        model=PINHOLE_RADIAL.kernel,
        pitch=WU_PIXEL_PITCH_M,
        frame=np.arange(len(fields)),
        frame_start=np.arange(len(fields) + 1),
        star_start=fields.star_start,
        row_px=(fields.row_px + noise[0])[places],
        col_px=(fields.col_px + noise[1])[places],
        sigma_px=np.full(n, sigma_px),
        s_i=np.ascontiguousarray(fields.s_i[places]),
        source_row=places,
        phi=np.empty(0),
        band=np.empty((0, 5)),
    )
    return arcsets.weigh(arcs, arcsets.angular_sigma(PINHOLE_RADIAL, WU_START, arcs))[0]


def _judged(head: Record, arcs: ArcSet, judges: Judges) -> list[Record]:
    """Run every estimator of a group; the truth itself comes first."""
    truth = {**head, "estimator": "truth", "weights": "full", **_criteria(WU_TRUTH, judges), "nees": None}
    records = [truth]
    for estimator in estimators(head["magnitude_limit"]):
        run = estimator.run(arcs)
        x = run.states[-1]
        error = x - WU_TRUTH
        record = {
            **head, "estimator": estimator.key, "weights": estimator.weights, **_criteria(x, judges),
            "error": error.tolist(), "nees": nees(error / START_SIGMA, run.P),
        }  # fmt: skip
        drawn = head["set"] == 0 and head["magnitude_limit"] == 5.5 and head["noise_px"] == WU_IMPLIED_SIGMA_PX
        if drawn and estimator.key in {"svd-4-23", "angular"}:
            record["course"] = _course(run, judges)
        records.append(record)
    if head["set"] == 0 and head["magnitude_limit"] == 5.5 and head["noise_px"] == WU_IMPLIED_SIGMA_PX:
        truth["observability"] = _observability(arcs, len(judges.fields))
    return records


def _criteria(x: FloatArray, judges: Judges) -> Record:
    return {"A": list(judges.criterion_a(x)), "B": list(judges.criterion_b(x))}


def _course(run: Run, judges: Judges) -> Record:
    """States, sigmas and criteria at places along a run, closer at its start."""
    places = np.unique(np.geomspace(1, len(run.states), CHECKPOINTS).round().astype(int)) - 1
    return {
        "frame": (places + 1).tolist(),
        "states": run.states[places].tolist(),
        "sigmas": [[None if np.isnan(one) else one for one in row] for row in run.sigmas[places].tolist()],
        "A": [judges.criterion_a(run.states[k])[0] for k in places],
        "B": [judges.criterion_b(run.states[k])[0] for k in places],
        "settled": _settled(run.states),
    }


def _settled(states: FloatArray) -> list[int]:
    """Frame from which each parameter stays within three precisions of W Table 1 of its end, (6,)."""
    away = np.abs(states - states[-1]) > 3 * WU_TYPICAL_SIGMA
    return [int(np.flatnonzero(column).max(initial=-1)) + 2 for column in away.T]


def _observability(arcs: ArcSet, n_frames: int) -> Record:
    """Minimum singular values of single frames at the truth (W Figures 3 and 4); null where a frame has too few rows."""
    view = View(PINHOLE_RADIAL, WU_TRUTH, FREE, WU_TYPICAL_SIGMA)
    few = arcs.frames(0, min(n_frames, arcs.n_frames))
    models, values = observability_of_models(view, few), observability_of_values(view, few)
    return {
        "frame": (few.frame + 1).tolist(),
        "models": [[one or None for one in column] for column in models.T.tolist()],
        "values": [[one or None for one in column] for column in values.T.tolist()],
        "information": _information_held(view, few),
    }


def _information_held(view: View, arcs: ArcSet) -> Record:
    """Variance of each parameter by SVD over that by AD, (6,), by what the weights are."""
    full = [whitened_information(view, arcs, selection) for selection in (None, CHOSEN)]
    diagonal = [weighted_information(view, arcs, selection)[0] for selection in (None, CHOSEN)]
    found = {}
    for weights, (angular, svd) in (("full", full), ("diagonal", diagonal)):
        ratio = np.diag(np.linalg.inv(svd)) / np.diag(np.linalg.inv(angular))
        found[weights] = ratio.tolist()
    return found
