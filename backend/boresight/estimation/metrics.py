"""Arclength errors and their root mean squares (E Eqs 12, 20, 32, 33), unweighted, in radians.

E Eq 20 as printed, sqrt(J / N) with J half and weighted, has no unit; the tables are in urad, so the erratum's
sqrt(sum dphi^2 / N) is what is meant. The tail RMS judges one state by the whole set (Eq 32); the aggregate RMS
judges each frame by the state the filter had after it (Eq 33).
"""

from __future__ import annotations

import numpy as np

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.stored_arcs import Arcs


def arc_errors(arcs: ArcSet, x: FloatArray) -> FloatArray:
    """Measured minus catalogue arclength of every arc, (n_arcs,) rad, at state x (n_parameters,)."""
    e = np.empty(arcs.n_arcs)
    kernels.residuals(arcs.camera.kind, x, arcs.pitch, arcs.star_start, arcs.row_px, arcs.col_px, arcs.known_phi, e)
    return e


def rms(arcs: Arcs, x: FloatArray) -> float:
    """RMS arclength error of the set at state x, rad."""
    return float(tail_rms(arcs, x[None])[0])


def tail_rms(arcs: Arcs, states: FloatArray) -> FloatArray:
    """RMS of the whole set at each of several states (n_states, n_parameters), rad (E Eq 32), in one pass over it."""
    return np.asarray(np.sqrt(sums_of_squares(arcs, states) / arcs.n_arcs))


def sums_of_squares(arcs: Arcs, states: FloatArray) -> FloatArray:
    """Sum of the squared errors of all arcs at each of several states, (n_states,) rad^2."""
    totals = np.zeros(len(states))
    for of_block in arcs.over_blocks(_squares_in_block, np.ascontiguousarray(states)):
        totals += of_block
    return totals


def _squares_in_block(block: ArcSet, states: FloatArray) -> FloatArray:
    """Sums of squares of one block at each state, (n_states,)."""
    totals = np.empty(len(states))
    kernels.sums_of_squares(
        block.camera.kind,
        states,
        block.pitch,
        block.star_start,
        block.row_px,
        block.col_px,
        block.known_phi,
        totals,
    )
    return totals


def aggregate_rms(sum_of_squares: FloatArray, n_arcs: FloatArray) -> FloatArray:
    """Running RMS of per-frame errors, each at its own state, up to every frame (n_frames,), rad (E Eq 33)."""
    return np.asarray(np.sqrt(np.cumsum(sum_of_squares) / np.maximum(np.cumsum(n_arcs), 1)))
