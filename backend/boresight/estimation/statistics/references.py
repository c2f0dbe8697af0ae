"""What each reference holds of the parameters: observability frame by frame, and information beside the Cramer-Rao bound.

Observability (W section 3.3.1, Figures 3 and 4). With H the rows of one frame, not whitened, and the typical sigmas as weights,
H' = H diag(scale), and |dz| >= sigma_min |dx| with sigma_min the smallest singular value of H' (errata to W Eqs 31 to 33: S Q^T,
and neither a sum of squares nor a factor 6). W compares the Models by it. It says how far the values move and nothing of how
well they are known, so that a row given twice counts twice: it ranks models of like rows, and is no measure of precision.

Information. Precision is the inverse of the information, which counts nothing twice::

    whitened by the full R           A = H^T R^+ H
    weighted by 1 / R_rr alone       A = B V^-1 B,      B = H^T D H,    V = H^T D R D H,    D = diag(1 / R_rr)

the second because weights that leave out the correlation still give an estimate, of covariance B^-1 V B^-1; its filter claims
B^-1, which is smaller. Relative to the bound of `cramer_rao`, which knows nothing of references, a share of one means that nothing
is lost; it may read a hundredth more, for R takes a pixel to be the same angle along the radius and across it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.cameras import CameraModel
from boresight.estimation import angular, singular_values
from boresight.estimation.arcs import ArcSet, angular_sigma
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.singular_values import APART, CHOSEN, DETERMINED, STAR_MODELS, VALUES, Selection
from boresight.kernels.references import judge_selections

Rows = tuple[FloatArray, FloatArray]

#: Stars of the fullest exposure squared, times the exposures of a run: its covariances take nine times as many numbers.
MOST_SQUARES = 2e5


@dataclass(frozen=True)
class EvaluationPoint:
    """Under which camera, state and scale a set is looked at.

    Parameters
    ----------
    camera
        The sensor's.
    x
        (n_parameters,) SI.
    free, scale
        (n_free,) places and typical sigmas of the free parameters.
    """

    camera: CameraModel
    x: FloatArray
    free: IntArray
    scale: FloatArray


@dataclass(frozen=True)
class SeenFrames:
    """Some frames as they are seen under a view, once for all references.

    Parameters
    ----------
    frame_start
        (n_frames + 1,) first exposure of each frame.
    star_start
        (n_exposures + 1,) first star of each exposure.
    s_i, sigma_rad
        (n_stars, 3) catalogue directions and (n_stars,) direction errors.
    s, D
        (n_stars, 3) measured directions and (n_stars, 3, n_parameters) ds/dx.
    """

    frame_start: IntArray
    star_start: IntArray
    s_i: FloatArray
    sigma_rad: FloatArray
    s: FloatArray
    D: FloatArray


def observability_of_models(view: EvaluationPoint, arcs: ArcSet) -> FloatArray:
    """Smallest singular value of H' of every frame under Models 1 to 4, (n_frames, 4): W Figure 3."""
    return judged(view, seen(view, arcs), [Selection(model, CHOSEN.values) for model in STAR_MODELS])[0].T


def observability_of_values(view: EvaluationPoint, arcs: ArcSet) -> FloatArray:
    """Smallest singular value of H' of every frame with one singular value alone, (n_frames, 3): W Figure 4."""
    return judged(view, seen(view, arcs), [Selection(CHOSEN.model, (k,)) for k in VALUES])[0].T


def judged(
    view: EvaluationPoint,
    runs: Sequence[SeenFrames],
    selections: Sequence[Selection],
    unmeasured: Collection[Selection] = (),
) -> tuple[FloatArray, FloatArray]:
    """Both measures of selections of singular values, in one pass.

    Returns
    -------
    smallest
        (n_selections, n_frames) smallest singular value of the rows of every frame; 0 where there are fewer rows than parameters,
        NaN of those `unmeasured`.
    information
        H^T R^+ H of all frames, (n_selections, n_free, n_free).
    """
    n_free = len(view.free)
    A, smallest = np.zeros((len(selections), n_free, n_free)), list[FloatArray]()
    models, chosen = np.array([one.model for one in selections]), np.array([one.chosen for one in selections])
    measured = np.array([one not in unmeasured for one in selections])
    for run in runs:
        smallest.append(np.empty((len(selections), len(run.frame_start) - 1)))
        judge_selections(
            run.frame_start, run.star_start, run.s_i, run.sigma_rad, run.s, run.D, view.free, view.scale,
            models, chosen, measured, APART, DETERMINED, smallest[-1], A,
        )  # fmt: skip
    return np.concatenate(smallest, axis=1), A


def seen(view: EvaluationPoint, arcs: ArcSet) -> list[SeenFrames]:
    """Frames of a set under a view, with the direction errors of its state, in runs whose covariances fit into memory."""
    sigma_rad, star_start = angular_sigma(view.camera, view.x, arcs), arcs.star_start
    s, D = arcs.camera.directions_and_jacobian(view.x, arcs.row_px, arcs.col_px, arcs.pitch)
    runs = []
    for first, last in pairwise(_runs(arcs)):
        e0, e1 = int(arcs.frame_start[first]), int(arcs.frame_start[last])
        stars = slice(int(star_start[e0]), int(star_start[e1]))
        frame_start, starts = arcs.frame_start[first : last + 1] - e0, star_start[e0 : e1 + 1] - stars.start
        runs.append(SeenFrames(frame_start, starts, arcs.s_i[stars], sigma_rad[stars], s[stars], D[stars]))
    return runs


def _runs(arcs: ArcSet) -> list[int]:
    """First frame of each run, and the end: the exposures of a run times the square of the fullest one's stars are bounded."""
    edges, most, exposures = [0], 0, 0
    fullest = np.maximum.reduceat(np.diff(arcs.star_start), arcs.frame_start[:-1])
    for k, (stars, count) in enumerate(zip(fullest.tolist(), np.diff(arcs.frame_start).tolist(), strict=True)):
        most, exposures = max(most, stars), exposures + count
        if exposures * most**2 > MOST_SQUARES and k > edges[-1]:
            edges.append(k)
            most, exposures = stars, count
    return [*edges, arcs.n_frames]


def relative(A: FloatArray, bound: FloatArray) -> FloatArray:
    """Variance of every parameter under the bound's information over that under A, (n_free,); 0 where A does not determine all."""
    if not np.isfinite(A).all() or np.linalg.matrix_rank(A, hermitian=True) < len(A):
        return np.zeros(len(A))
    return np.asarray(np.diag(np.linalg.inv(bound)) / np.diag(np.linalg.inv(A)))


def whitened_information(view: EvaluationPoint, arcs: ArcSet, selection: Selection | None) -> FloatArray:
    """H^T R^+ H of a whitened set (n_free, n_free): of singular values, or of all pairs for None."""
    runs = seen(view, arcs)
    return information_of_pairs(view, runs) if selection is None else judged(view, runs, [selection], [selection])[1][0]


def information_of_pairs(view: EvaluationPoint, runs: Sequence[SeenFrames]) -> FloatArray:
    """H^T R^+ H of all pairs of some frames, (n_free, n_free)."""
    reference = AllPairs(view.free, view.scale)
    A = np.zeros((len(view.free), len(view.free)))
    for run in runs:
        reference.whiten(run.star_start, run.s_i, run.sigma_rad)
        _, H = reference.rows(run.s, run.D)
        A += H.T @ H
    return A


def weighted_information(
    view: EvaluationPoint, arcs: ArcSet, selection: Selection | None
) -> tuple[FloatArray, FloatArray]:
    """Information B V^-1 B that weights 1 / R_rr leave of a whitened set, and B, which they claim; both (n_free, n_free)."""
    B, V = np.zeros((len(view.free), len(view.free))), np.zeros((len(view.free), len(view.free)))
    for frame in seen(view, arcs):
        s, D = frame.s, frame.D
        for first, last in pairwise(frame.star_start):
            stars = slice(int(first), int(last))
            g, R = _gradients(s[stars], frame.s_i[stars], frame.sigma_rad[stars], selection)
            H = np.einsum("rnj,njp->rp", g, D[stars][:, :, view.free]) * view.scale
            weighted = H / np.diag(R)[:, None]
            B += H.T @ weighted
            V += weighted.T @ R @ weighted
    return B @ np.linalg.pinv(V, hermitian=True) @ B, B


def _gradients(s: FloatArray, s_i: FloatArray, sigma_rad: FloatArray, selection: Selection | None) -> Rows:
    """Gradients (m, n, 3) of one exposure's measurements and their covariance (m, m)."""
    if selection is None:
        return angular.angles(s)[1], angular.covariance(s_i, sigma_rad)
    taken = singular_values.exposure(s_i, sigma_rad, selection)
    return singular_values.stacked(s, taken.rows, selection)[1], taken.R
