"""What goes into a filter and what comes out, the same for every one.

Between frames the parameters may have moved. Process noise says by how much, P <- P + Q. A forgetting factor lambda says how fast
the past loses weight, P <- P / lambda: a frame m frames old counts lambda^m, so that the information of a constant parameter
comes to rest at that of 1 / (1 - lambda) frames, whatever the parameter. That is a cautious claim: where nothing moved, errors have
1 / (1 + lambda) of the claimed variance. Both may act, the forgetting first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.estimation.singular_values import CHOSEN, Selection

#: Largest departure of a whitened residual from its linear prediction at which a frame is not linearised again.
REST = 1e-3


@dataclass(frozen=True)
class Tuning:
    """Choices of a sequential estimator.

    Parameters
    ----------
    linearisations
        Most linearisations a frame; 1 is the printed filter, which a Table III start makes far over-confident.
    process_noise
        Standard deviation added a frame to each free parameter, (n_free,) or one for all, in typical sigmas; 0 is No-Q.
    forgetting
        lambda, the share of its information that the filter carries from frame to frame; 1 forgets nothing.
    rest
        See `REST`.
    selection
        Of the filter on singular values: which of them are measured.
    gain_form
        Of the filters in `information`: `information`, or `gain` for the printed update, which is slower and gives the same.
    """

    linearisations: int = 6
    process_noise: float | FloatArray = 0.0
    forgetting: float = 1.0
    rest: float = REST
    selection: Selection = CHOSEN
    gain_form: str = "information"

    @property
    def widening(self) -> float:
        """What a square root of the covariance is multiplied by between frames."""
        return float(1 / np.sqrt(self.forgetting))


@dataclass(frozen=True)
class FilterState:
    """Mean and square root of the covariance of the free parameters, between frames.

    Parameters
    ----------
    x
        (n_parameters,) state, SI.
    z
        (n_free,) departure of the free parameters from their start, in typical sigmas.
    S
        (n_free, n_free) upper triangular, covariance of z = S S^T.
    """

    x: FloatArray
    z: FloatArray
    S: FloatArray

    @property
    def P(self) -> FloatArray:
        """Covariance of the free parameters in typical sigmas, (n_free, n_free)."""
        return np.asarray(self.S @ self.S.T)


def start(x0: FloatArray, n_free: int, initial_sigma_scale: float) -> FilterState:
    """State before any frame: P = (initial_sigma_scale typical sigmas)^2 I."""
    return FilterState(x0.copy(), np.zeros(n_free), initial_sigma_scale * np.eye(n_free))


@dataclass(frozen=True)
class FilterHistory:
    """The filter after each frame; leading dimension n_frames.

    Parameters
    ----------
    states
        (n_frames, n_parameters), SI.
    sigmas
        (n_frames, n_free), one-sigma in typical sigmas.
    nis, dof
        Normalised innovation squared of each frame and its degrees of freedom.
    sum_of_squares
        Unweighted, of each frame at its own posterior state, rad^2 (E Eq 33).
    linearisations
        How often each frame was linearised.
    last
        State after the last frame.
    finite
        False when the state ran away; the arrays then end at the frame before.
    blind
        Places among the free parameters whose spread took it away: see `unscented.blind_parameters`.
    """

    states: FloatArray
    sigmas: FloatArray
    nis: FloatArray
    dof: IntArray
    sum_of_squares: FloatArray
    linearisations: IntArray
    last: FilterState
    finite: bool
    blind: tuple[int, ...] = ()
