"""The square-root unscented filter: slopes from points spread as wide as the state is uncertain, not from derivatives.

P = S S^T with S upper triangular, n free parameters. The whitened residual e' of a frame is taken at 2n points of equal weight,

    z +- gamma S_i,    gamma^2 = n,    weights 1 / 2n,

whose mean is z and whose covariance is P. The odd and the even part of e' over each pair,

    d_i = (e'_i+ - e'_i-) / (2 gamma)            c_i = ((e'_i+ + e'_i-) / 2 - mean e') / gamma,

give the line that fits e' best over the spread of z, and what it leaves unexplained:

    H = P_ez^T P^-1 = D S^T (S S^T)^-1 = D S^-1           Omega = P_ee - H P H^T = C C^T.

No difference of large numbers is left in Omega, so it is never indefinite. The measurement becomes mean e' + H (z - z_at) + v with
v of covariance I + C C^T. This is whitened by one rank-one step a column of C, O(n_arcs n^2), and its rows are then taken in one
by one from the frame's prior by Carlson's update, as in `square_root`: the covariance is never formed, and stays positive.

One pass is the unscented Kalman filter as every textbook has it. From a ground calibration ten sigmas off it does not hold: the
points lie 28 typical sigmas out, and where the residual is that bent no one line says what it says near the truth. So the
regression is made again about the posterior, until that rests or Omega vanishes (iterated posterior linearisation; the iterated
extended filter is its limit for a narrow spread). The curvature that is left over the posterior's spread stays counted as noise.

A lens whose distortion turns back has no ray beyond the turn, and the spread of a ground calibration may reach there, at some
point for some star. The prior enters an update by its own mean and covariance; points only say over which spread the residuals
are made a line, and each regression is replaced by the next. So where a star has no ray, points are drawn over a half of the
spread, a quarter, and so on, until all stars have one, and the frame goes on from there. It never ends on such points: its last
regression is over the whole spread of its posterior, as without a turn, and so is what it rests at. Where the lens does not have
even that spread, or with one pass alone, the filter ends, and says which parameters' spread reached so far. (Julier's scaled
transform would keep a narrow regression as if it held over the wide spread.)

Nothing so far makes the passes contract. Of eleven parameters of a decentred lens the points of a ground calibration lie 33
typical sigmas out, where a sixth order of the radius moves a corner star by thousands of pixels; a line through that may set the
posterior eight sigmas of the prior away from it, the next line is about that place, and the passes run off (3 of 40 sets). So a
frame that does not come to rest is taken in once more from its prior, and now a posterior that raises the frame's cost

    |S_prior^-1 (z - z_prior)|^2 + |e'(z)|^2

by more than n, what a posterior's own spread makes of it, is not believed: its points are drawn over half the spread again, as
where a star has no ray. In the limit of a narrow spread this is the step of the iterated extended filter. A frame that rests at
once is left as it is.

References
----------
van der Merwe, Wan, "The square-root unscented Kalman filter", ICASSP 2001. Garcia-Fernandez, Svensson, Morelande, Sarkka,
"Posterior linearization filter", IEEE TSP 63, 2015.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from boresight import kernels
from boresight.arrays import FloatArray
from boresight.estimation.arcs import ArcSet
from boresight.estimation.filters.history import FilterHistory, FilterState, Tuning
from boresight.estimation.filters.information import upper_factor
from boresight.estimation.filters.square_root import padded

#: Move of the posterior, in its own sigmas, at which a frame rests: a fiftieth changes NEES by less than a thousandth.
REST_SIGMA = 0.02
#: Largest share by which a sigma may shrink in the last regression; its points then lay at most a tenth too wide.
SHRUNK = 0.1
#: Trace of Omega below which the residuals are straight over the spread, so that one regression serves all of it.
STRAIGHT = 1e-4
#: Share of the spread below which no narrower one is tried: its points then say what a derivative would.
LEAST_SHARE = 1e-3


def unscented_filter(
    arcs: ArcSet, state: FilterState, free: NDArray[np.int64], scale: FloatArray, tuning: Tuning
) -> FilterHistory:
    """Run the filter over a set; parameters and result as in `square_root_filter`, one linearisation being one regression."""
    n, n_free = arcs.n_frames, len(free)
    x, q = state.x.copy(), np.full(n_free, tuning.process_noise)
    z, S, q = (padded(values, len(x)) for values in (state.z, state.S, q))
    states, sigmas = np.empty((n, len(x))), np.empty((n, n_free))
    nis, dof, squares, passes = np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64)
    done = kernels.unscented_filter(
        x, z, S, q, tuning.widening, arcs.camera.kind, arcs.pitch, arcs.frame_start, arcs.star_start, arcs.row_px, arcs.col_px,
        arcs.known_phi, arcs.band, free, scale, tuning.linearisations, REST_SIGMA, SHRUNK, STRAIGHT, LEAST_SHARE,
        states, sigmas, nis, dof, squares, passes,
    )  # fmt: skip
    history = FilterHistory(
        states[:done], sigmas[:done], nis[:done], dof[:done], squares[:done], passes[:done],
        FilterState(x, z[:n_free], S[:n_free, :n_free]), done == n,
    )  # fmt: skip
    if history.finite:
        return history
    before = unscented_filter(arcs.frames(0, done), state, free, scale, tuning).last if done else state
    return replace(history, blind=blind_parameters(arcs.frames(done, done + 1), before, free, scale, tuning))


def blind_parameters(
    frame: ArcSet, state: FilterState, free: NDArray[np.int64], scale: FloatArray, tuning: Tuning
) -> tuple[int, ...]:
    """Places of the free parameters whose points before a frame give some of its stars no ray, ascending."""
    n = len(free)
    S = upper_factor(state.P / tuning.forgetting + tuning.process_noise**2 * np.eye(n))
    blind = set()
    for column in S.T:
        for reach in (np.sqrt(n), -np.sqrt(n)):
            x = state.x.copy()
            x[free] += scale * reach * column
            if not np.isfinite(frame.camera.directions(x, frame.row_px, frame.col_px, frame.pitch)).all():
                blind.add(int(np.argmax(np.abs(column))))
    return tuple(sorted(blind))
