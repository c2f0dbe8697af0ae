"""What the study runs on each set: singular values and angular distances, with the full R and with a diagonal one.

The paper gives neither R nor P_0 nor Q. P_0 is here `START_SIGMA`, which its start needs: f begins 0.5 mm off. Q is 0, as its
text says of constant parameters. For R two readings are run:

- full: the covariance that centroid noise gives overlapping combinations, with as many linearisations a frame as it takes: the
  product's own filters `svd` and `angular`;
- diagonal: R = r^2 I, r = sigma_px Delta / f (times sqrt 2 for a distance between two stars), every row counted as if it were
  independent, and one linearisation a frame: the simplest reading of W Eqs 25 to 28,

      Lambda+ = Lambda + H^T H / r^2,      z+ = z - (Lambda+)^-1 H^T e / r^2,

  or in the printed gain form K = P H^T (H P H^T + R)^-1, which is the same and serves the clock.

The full R is taken at the state; the first frames set it at the printed start, whose pixels are 3 % too large, the others at
what those gave.

One simulated set of each group at each centroid noise, every estimator run on it and judged.

A group's star fields are the same at both noises, and so is the noise in units of its deviation.

The paper's two criteria (W 4.1): how well calibrated directions keep the angles between the stars of an image.

For each image the root mean square over all pairs of stars of the measured minus the catalogue angle; over the images its mean and
standard deviation. Criterion A takes the centroids without noise, so only the parameters count; criterion B the noisy ones.
At the truth B is the noise alone, about sqrt(2) sigma_px Delta / f: an angle has two ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from boresight.arrays import ARCSEC_PER_RAD, FloatArray, IntArray
from boresight.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation import arcs as arcsets
from boresight.estimation.angular import all_pairs
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.filters import FILTERS, FilterState, Tuning
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.history import start
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN, Selection
from boresight.estimation.statistics.consistency import nees
from boresight.estimation.statistics.references import (
    EvaluationPoint,
    observability_of_models,
    observability_of_values,
    weighted_information,
    whitened_information,
)
from boresight.papers.wu import printed
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

#: P_0 of s, f, u0, v0, k1, k2 as standard deviations, SI.
START_SIGMA = np.array([1e-2, 5e-4, 20.0, 20.0, 0.5, 0.5])
FREE = np.arange(len(START_SIGMA))
#: Magnitude to which an image holds about the 14.7 stars of the field experiment (W 4.2).
FIELD_LIMIT = 5.25
#: Frames before the full R is taken again.
FIRST_FRAMES = 20


@dataclass(frozen=True)
class Estimator:
    """One way to calibrate."""

    method: str
    weights: str
    selection: Selection = CHOSEN

    @property
    def key(self) -> str:
        """Name in documents."""
        values = "".join(map(str, self.selection.values))
        return f"svd-{self.selection.model}-{values}" if self.method == "svd" else "angular"

    def run(self, arcs: ArcSet) -> Run:
        """Run it over a whitened set from the printed start."""
        return _diagonal(self, arcs) if self.weights == "diagonal" else _full(self, arcs)

    def reference(self) -> SingularValues | AllPairs:
        """Return what it measures."""
        if self.method == "svd":
            return SingularValues(self.selection, FREE, START_SIGMA)
        return AllPairs(FREE, START_SIGMA)

    def row_sigma(self, arcs: ArcSet) -> float:
        """Standard deviation r of a row under diagonal weights, rad."""
        r = float(arcs.sigma_px[0] * arcs.pitch / WU_START[1])
        return r if self.method == "svd" else float(r * np.sqrt(2))


@dataclass(frozen=True)
class Run:
    """A filter's states and what it claims at its end.

    `states`: (n_frames, 6), SI. `sigmas`: (n_frames, 6) claimed standard deviations, SI; of diagonal weights the last
    only, NaN before. `P`: (6, 6) covariance at the end in units of `START_SIGMA`.
    """

    states: FloatArray
    sigmas: FloatArray
    P: FloatArray


def estimators(magnitude_limit: float) -> list[Estimator]:
    """What runs on a group: all combinations on the one of Tables 2 and 3, SVD and AD on all; on the field experiment SVD."""
    if magnitude_limit == FIELD_LIMIT:
        return [Estimator("svd", "full")]
    selections = [CHOSEN]
    if magnitude_limit == 5.5:
        selections = [Selection(model) for model in printed.MODELS]
        selections += [Selection(4, values) for values in printed.SUBSETS if values != (2, 3)]
    made = [("svd", selection) for selection in selections] + [("angular", CHOSEN)]
    return [Estimator(method, weights, selection) for weights in ("full", "diagonal") for method, selection in made]


def _full(estimator: Estimator, arcs: ArcSet) -> Run:
    """Run the product's filter, its weights taken at the start and once more soon after."""
    tuning = Tuning(selection=estimator.selection)
    state, parts = start(WU_START, len(FREE), 1.0), []
    for first, last in ((0, FIRST_FRAMES), (FIRST_FRAMES, arcs.n_frames)):
        parts.append(FILTERS[estimator.method](arcs.frames(first, last), state, FREE, START_SIGMA, tuning))
        state = parts[-1].last
    states, sigmas = (np.concatenate([getattr(part, name) for part in parts]) for name in ("states", "sigmas"))
    return Run(states, sigmas * START_SIGMA, state.P)


def _diagonal(estimator: Estimator, arcs: ArcSet) -> Run:
    """Run the printed filter with R = r^2 I in information form."""
    reference, weight = estimator.reference(), 1 / estimator.row_sigma(arcs) ** 2
    sigma_rad = angular_sigma(PINHOLE_RADIAL, WU_START, arcs)
    x, z, information = WU_START.copy(), np.zeros(len(FREE)), np.eye(len(FREE))
    states = np.empty((arcs.n_frames, len(x)))
    for k in range(arcs.n_frames):
        e, H = _rows(reference, Frame(arcs, k, sigma_rad), x)
        information = information + weight * H.T @ H
        z = z - np.linalg.solve(information, weight * H.T @ e)
        states[k] = x = WU_START + START_SIGMA * z
    P = np.asarray(np.linalg.inv(information), dtype=np.float64)
    sigmas = np.full_like(states, np.nan)
    sigmas[-1] = START_SIGMA * np.sqrt(np.diag(P))
    return Run(states, sigmas, P)


def gain_filter(estimator: Estimator, arcs: ArcSet, state: FilterState) -> FloatArray:
    """Run the printed filter with R = r^2 I in its printed gain form (W Eqs 25 to 27); returns the last state (6,)."""
    reference, r = estimator.reference(), estimator.row_sigma(arcs)
    sigma_rad = angular_sigma(PINHOLE_RADIAL, state.x, arcs)
    x, z, P = state.x, state.z, state.P
    for k in range(arcs.n_frames):
        e, H = _rows(reference, Frame(arcs, k, sigma_rad), x)
        HP = H @ P
        K = np.linalg.solve(HP @ H.T + r**2 * np.eye(len(e)), HP).T
        z, P = z - K @ e, P - K @ HP
        x = state.x + START_SIGMA * (z - state.z)
    return x


def _rows(reference: SingularValues | AllPairs, frame: Frame, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (m,) and scaled Jacobian (m, 6) of a frame of one exposure, every row that is measured."""
    reference.whiten(frame.star_start, frame.s_i, frame.sigma_rad)
    return measured_rows(reference, *frame.directions(x))


def measured_rows(reference: SingularValues | AllPairs, s: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (m,) and scaled Jacobian (m, 6) of measured directions of one exposure, before whitening."""
    e, H = (part[0] for part in reference.unwhitened(s, D))
    measured = np.any(H, axis=1)
    return e[measured], H[measured]


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
    """Run every estimator on one set of each group, and one on as many stars as the field experiment saw; a record each."""
    records = []
    for limit in (*printed.GROUPS, FIELD_LIMIT):
        for noise_px in NOISES_PX if limit in printed.GROUPS else NOISES_PX[:1]:
            arcs, judges = draw_trial(trial, limit, catalogue_folder, noise_px)
            stars = arcs.n_stars / arcs.n_exposures
            head = {"set": trial.index, "magnitude_limit": limit, "noise_px": noise_px, "stars": stars}
            records += _judged(head, arcs, judges)
    return records


def draw_trial(
    trial: Trial, limit: float, catalogue_folder: Path | None, noise_px: float = NOISES_PX[0]
) -> tuple[ArcSet, Judges]:
    """Draw the images of one set down to a limiting magnitude: those that calibrate, and those that judge."""
    seeds = np.random.SeedSequence([trial.index, (*printed.GROUPS, FIELD_LIMIT).index(limit)]).spawn(2)
    rng, noise = map(np.random.default_rng, seeds)
    fields, judged = (draw_fields(limit, n, rng, catalogue_folder) for n in (trial.frames, trial.judges))
    return noisy(fields, noise_px, noise), Judges.of(judged, noise_px, noise)


def draw_fields(limit: float, n_fields: int, rng: np.random.Generator, catalogue_folder: Path | None) -> StarFields:
    """Draw star fields of a group."""
    s_i = directions(_catalogue(catalogue_folder).brighter_than(limit))
    return random_fields(wu_sensor(), WU_TRUTH, s_i, n_fields, rng, galactic_latitude_deg=GALACTIC_LATITUDE_DEG)


@cache
def _catalogue(folder: Path | None) -> Catalogue:
    return load_catalogue(folder, max(printed.GROUPS))


def noisy(fields: StarFields, sigma_px: float, rng: np.random.Generator) -> ArcSet:
    """Add noise to star fields, order their stars and whiten them at the printed start."""
    n = len(fields.row_px)
    noise = sigma_px * rng.normal(size=(2, n))
    places, _ = arcsets.order(fields.star_start, fields.s_i)
    arcs = ArcSet(
        camera=PINHOLE_RADIAL,
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
    return arcsets.whiten(arcs, arcsets.angular_sigma(PINHOLE_RADIAL, WU_START, arcs))[0]


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
        if (estimator.key, estimator.weights) == ("svd-4-23", "full"):
            record["settled"] = _settled(run.states)
        drawn = head["set"] == 0 and head["magnitude_limit"] == 5.5 and head["noise_px"] == WU_IMPLIED_SIGMA_PX
        if drawn and estimator.key in {"svd-4-23", "angular"}:
            record["history"] = _history(run, judges)
        records.append(record)
    if head["set"] == 0 and head["magnitude_limit"] == 5.5 and head["noise_px"] == WU_IMPLIED_SIGMA_PX:
        truth["observability"] = _observability(arcs, len(judges.fields))
    return records


def _criteria(x: FloatArray, judges: Judges) -> Record:
    return {"A": list(judges.criterion_a(x)), "B": list(judges.criterion_b(x))}


def _history(run: Run, judges: Judges) -> Record:
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
    view = EvaluationPoint(PINHOLE_RADIAL, WU_TRUTH, FREE, WU_TYPICAL_SIGMA)
    few = arcs.frames(0, min(n_frames, arcs.n_frames))
    models, values = observability_of_models(view, few), observability_of_values(view, few)
    return {
        "frame": (few.frame + 1).tolist(),
        "models": [[one or None for one in column] for column in models.T.tolist()],
        "values": [[one or None for one in column] for column in values.T.tolist()],
        "information": _information_held(view, few),
    }


def _information_held(view: EvaluationPoint, arcs: ArcSet) -> Record:
    """Variance of each parameter by SVD over that by AD, (6,), by what the weights are."""
    full = [whitened_information(view, arcs, selection) for selection in (None, CHOSEN)]
    diagonal = [weighted_information(view, arcs, selection)[0] for selection in (None, CHOSEN)]
    found = {}
    for weights, (angular, svd) in (("full", full), ("diagonal", diagonal)):
        ratio = np.diag(np.linalg.inv(svd)) / np.diag(np.linalg.inv(angular))
        found[weights] = ratio.tolist()
    return found


@dataclass(frozen=True)
class Judges:
    """The images that judge a calibration.

    `row_px`, `col_px`: (n_stars,) the same with noise. `pair`: (n_pairs, 2) stars of every pair of an image. `image`:
    (n_pairs,) whose they are. `angle`: (n_pairs,) of the catalogue, rad.
    """

    fields: StarFields
    row_px: FloatArray
    col_px: FloatArray
    pair: IntArray
    image: IntArray
    angle: FloatArray

    @classmethod
    def of(cls, fields: StarFields, sigma_px: float, rng: np.random.Generator) -> Judges:
        """Add noise to fields and list their pairs."""
        noise = sigma_px * rng.normal(size=(2, len(fields.row_px)))
        counts = np.diff(fields.star_start)
        found = [first + all_pairs(int(n)) for first, n in zip(fields.star_start[:-1], counts, strict=True)]
        pair, image = np.concatenate(found), np.repeat(np.arange(len(fields)), list(map(len, found)))
        return cls(fields, fields.row_px + noise[0], fields.col_px + noise[1], pair, image, _angles(fields.s_i, pair))

    def criterion_a(self, x: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of criterion A, arcseconds, at parameters x (6,)."""
        return self._judge(x, self.fields.row_px, self.fields.col_px)

    def criterion_b(self, x: FloatArray) -> tuple[float, float]:
        """Mean and standard deviation of criterion B, arcseconds, at parameters x (6,)."""
        return self._judge(x, self.row_px, self.col_px)

    def _judge(self, x: FloatArray, row_px: FloatArray, col_px: FloatArray) -> tuple[float, float]:
        s = PINHOLE_RADIAL.directions(x, row_px, col_px, WU_PIXEL_PITCH_M)
        squared = (_angles(s, self.pair) - self.angle) ** 2
        rms = np.sqrt(np.bincount(self.image, squared) / np.bincount(self.image)) * ARCSEC_PER_RAD
        return float(rms.mean()), float(rms.std())


def _angles(s: FloatArray, pair: IntArray) -> FloatArray:
    """Angles (n,) of pairs of directions, from chords, which keep small angles exact."""
    chord = np.linalg.norm(s[pair[:, 0]] - s[pair[:, 1]], axis=1)
    return np.asarray(2 * np.arcsin(chord / 2))
