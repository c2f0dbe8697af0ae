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

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from boresight.estimation import angular, singular_values
from boresight.estimation.arcs import ArcSet, angular_sigma, weigh
from boresight.estimation.batch import normal_equations
from boresight.estimation.cameras import CameraModel
from boresight.estimation.cramer_rao import centroid_rows
from boresight.estimation.filters.angular import AllPairs
from boresight.estimation.filters.information import Frame, Reference
from boresight.estimation.filters.singular import SingularValues
from boresight.estimation.singular_values import CHOSEN, STAR_MODELS, VALUES, Selection

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rows = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class View:
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


def observability_of_models(view: View, arcs: ArcSet, values: tuple[int, ...] = CHOSEN.values) -> FloatArray:
    """Smallest singular value of H' of every frame under Models 1 to 4, (n_frames, 4): W Figure 3."""
    return np.stack([_smallest(view, arcs, Selection(model, values)) for model in STAR_MODELS], axis=1)


def observability_of_values(view: View, arcs: ArcSet, model: int = CHOSEN.model) -> FloatArray:
    """Smallest singular value of H' of every frame with one singular value alone, (n_frames, 3): W Figure 4."""
    return np.stack([_smallest(view, arcs, Selection(model, (k,))) for k in VALUES], axis=1)


def _smallest(view: View, arcs: ArcSet, selection: Selection) -> FloatArray:
    """Smallest singular value of the rows of every frame, (n_frames,); 0 where there are fewer rows than parameters."""
    reference = SingularValues(selection, view.free, view.scale)
    smallest = np.zeros(arcs.n_frames)
    for k, frame in enumerate(_frames(view, arcs)):
        reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
        _, H = reference.unwhitened(*frame.directions(view.x))
        flat = H.reshape(-1, len(view.free))  # rows that are not measured are zero, and add nothing
        if np.any(flat, axis=1).sum() >= len(view.free):
            smallest[k] = np.linalg.svd(flat, compute_uv=False)[-1]
    return smallest


def _frames(view: View, arcs: ArcSet) -> Iterator[Frame]:
    """Frames of a weighed set with the direction errors of the view's state."""
    sigma_rad = angular_sigma(view.camera, view.x, arcs)
    for k in range(arcs.n_frames):
        yield Frame(arcs, k, sigma_rad)


@dataclass(frozen=True)
class Content:
    """Information of references relative to the Cramer-Rao bound.

    Parameters
    ----------
    names
        (n_references,) `arcs`, `angular`, `svd 1` ... `svd 4`.
    full
        (n_references, n_free) variance of the bound over that of each parameter, whitened by the full R; 0 where undetermined.
    diagonal
        The same with weights 1 / R_rr alone; NaN for the arcs, which are never so weighted here.
    claimed
        What a filter with those weights claims: above its `diagonal`, and where it is above one, more than there is.
    """

    names: tuple[str, ...]
    full: FloatArray
    diagonal: FloatArray
    claimed: FloatArray


def information_content(view: View, arcs: ArcSet, values: tuple[int, ...] = CHOSEN.values) -> Content:
    """Set every reference beside the bound, at the state of the view."""
    bound = centroid_rows(view.camera, view.x, arcs, view.free, view.scale).information
    weighed, _ = weigh(arcs, angular_sigma(view.camera, view.x, arcs))
    full = [normal_equations(weighed, view.x, view.free, view.scale).A, whitened_information(view, weighed, None)]
    weighted = [weighted_information(view, weighed, None)]
    for model in STAR_MODELS:
        full.append(whitened_information(view, weighed, Selection(model, values)))
        weighted.append(weighted_information(view, weighed, Selection(model, values)))
    unknown = np.full(len(view.free), np.nan)
    return Content(
        ("arcs", "angular", *(f"svd {model}" for model in STAR_MODELS)),
        np.stack([relative(A, bound) for A in full]),
        np.stack([unknown, *(relative(true, bound) for true, _ in weighted)]),
        np.stack([unknown, *(relative(claimed, bound) for _, claimed in weighted)]),
    )


def relative(A: FloatArray, bound: FloatArray) -> FloatArray:
    """Variance of every parameter under the bound's information over that under A, (n_free,); 0 where A does not determine all."""
    if not np.isfinite(A).all() or np.linalg.matrix_rank(A, hermitian=True) < len(A):
        return np.zeros(len(A))
    return np.asarray(np.diag(np.linalg.inv(bound)) / np.diag(np.linalg.inv(A)))


def whitened_information(view: View, arcs: ArcSet, selection: Selection | None) -> FloatArray:
    """H^T R^+ H of a weighed set (n_free, n_free): of singular values, or of all pairs for None."""
    reference: Reference = AllPairs(view.free, view.scale)
    if selection is not None:
        reference = SingularValues(selection, view.free, view.scale)
    A = np.zeros((len(view.free), len(view.free)))
    for frame in _frames(view, arcs):
        reference.weigh(frame.star_start, frame.s_i, frame.sigma_rad)
        _, H = reference.rows(*frame.directions(view.x))
        A += H.T @ H
    return A


def weighted_information(view: View, arcs: ArcSet, selection: Selection | None) -> tuple[FloatArray, FloatArray]:
    """Information B V^-1 B that weights 1 / R_rr leave of a weighed set, and B, which they claim; both (n_free, n_free)."""
    B, V = np.zeros((len(view.free), len(view.free))), np.zeros((len(view.free), len(view.free)))
    for frame in _frames(view, arcs):
        s, D = frame.directions(view.x)
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
