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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.cameras.pinhole_radial import PINHOLE_RADIAL
from boresight.estimation.filters import FILTERS, FilterState, Tuning
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.history import start
from boresight.estimation.filters.information import Frame
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN, Selection
from boresight.simulation.sensors import WU_START
from boresight.studies.wu import printed

#: P_0 of s, f, u0, v0, k1, k2 as standard deviations, SI.
START_SIGMA = np.array([1e-2, 5e-4, 20.0, 20.0, 0.5, 0.5])
FREE = np.arange(len(START_SIGMA))
#: Frames before the full R is taken anew.
FIRST_FRAMES = 20


@dataclass(frozen=True)
class Estimator:
    """One way to calibrate.

    Parameters
    ----------
    method
        `svd` or `angular`.
    weights
        `full` or `diagonal`.
    selection
        Of `svd`.
    """

    method: str
    weights: str
    selection: Selection = CHOSEN

    @property
    def key(self) -> str:
        """Name in documents."""
        values = "".join(map(str, self.selection.values))
        return f"svd-{self.selection.model}-{values}" if self.method == "svd" else "angular"

    def run(self, arcs: ArcSet) -> Run:
        """Run it over a weighed set from the printed start."""
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

    Parameters
    ----------
    states
        (n_frames, 6), SI.
    sigmas
        (n_frames, 6) claimed standard deviations, SI; of diagonal weights the last only, NaN before.
    P
        (6, 6) covariance at the end in units of `START_SIGMA`.
    """

    states: FloatArray
    sigmas: FloatArray
    P: FloatArray


def estimators(magnitude_limit: float) -> list[Estimator]:
    """What runs on a group: all combinations on the one of Tables 2 and 3, SVD and AD on all."""
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
    reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
    e, H = (part[0] for part in reference.unwhitened(*frame.directions(x)))
    measured = np.any(H, axis=1)
    return e[measured], H[measured]
