"""Normalised innovations over time: whether every part of the set is as well explained as the whole.

A filter gives them itself: of each update the normalised innovation squared, chi-square with as many degrees of freedom as
arcs. A batch has none, so each frame is judged at the end state, which it helped to find: its chi-square has the mean m_k - l_k
with m_k its arcs and l_k = tr(H_k A^-1 H_k^T) its leverage, and is compared with a chi-square distribution of that many degrees
of freedom. (Exact would be a sum of weighted squares; the weights differ from one by l_k / m_k at most on average, 0.1 % for a
frame among a hundred.)

The frames that the best fit explains worst, to be looked at one by one.

Frame k has the chi-square e_k^T e_k of m_k arcs, of which its own pull on the parameters took l_k (`ground`): it is compared with
chi-square of m_k - l_k degrees of freedom. So that frames of few and of many stars stand in one order, it is turned into a normal
deviate (Wilson & Hilferty 1931), good to a tenth of a sigma at four, from five degrees of freedom on:

    deviate = ((chi2 / dof)^(1/3) - (1 - 2 / (9 dof))) / sqrt(2 / (9 dof)).

Reference: Wilson, Hilferty, "The distribution of chi-square", PNAS 17, 1931.

Whether the residuals change with time: the scores of the frames tell, parameter by parameter.

A camera that drifts by dz_k in parameter p leaves in frame k the score b_kp = (H_k^T e_k)_p = A_kpp dz_k + noise of variance
A_kpp. Over

    y_kp = b_kp / sqrt(A_kpp)

the noise has variance one in every frame, however many stars it has, and the drift stands out as far as one parameter's
residual can show it; a sum of squares would not see its sign. At a constant camera y_kp is white over k. Ljung and Box's test
(estimation.consistency) is made of each free parameter, and the least p-value counts, times their number (Bonferroni). Below 1
% the series is not white.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from boresight.arrays import FloatArray
from boresight.calibration.calibration import LjungBox, NisOverTime, Values, Whiteness, WorstFrames
from boresight.calibration.trust.fitted_set import UNLIKELY, FittedSet, Unavailable, nested, probability
from boresight.estimation.statistics.consistency import CONFIDENCE, ljung_box, runs_p_value, share_bounds
from boresight.estimation.statistics.special import chdtrc, chdtri, ndtr

FEWEST_FRAMES = 20
MOST_LAGS = 20
#: Lags that the test sums: a drift shows in the first, and with twenty Q is far from chi-square at a few hundred frames.
TESTED_LAGS = 5


def whiteness(fitted: FittedSet) -> Whiteness:
    """Autocorrelation of the least white score, and the test over all of them."""
    n = fitted.arcs.n_frames
    if n < FEWEST_FRAMES:
        raise Unavailable(
            f"At least {FEWEST_FRAMES} frames are needed to distinguish a trend from noise; there are {n}: add frames."
        )
    y = np.ascontiguousarray((fitted.sums.scores / np.sqrt(np.maximum(fitted.sums.squares, np.finfo(float).tiny))).T)
    lags = min(MOST_LAGS, n // 5)
    tests = [ljung_box(series, min(TESTED_LAGS, lags)) for series in y]
    least = int(np.argmin([test.p for test in tests]))
    p = min(1.0, tests[least].p * len(tests))
    return Whiteness(
        lags=list(range(1, lags + 1)),
        autocorrelation=nested(ljung_box(y[least], lags).autocorrelation),
        bound=float(1.96 / np.sqrt(n)),
        name=fitted.names[least],
        ljung_box=LjungBox(value=tests[least].value, dof=tests[least].dof, p=p),
        p_of_parameters=Values({name: test.p for name, test in zip(fitted.names, tests, strict=True)}),
        white=p >= UNLIKELY,
        sentence=_whiteness_sentence(fitted.symbols[least], p, n, p >= UNLIKELY),
    )


def _whiteness_sentence(symbol: str, p: float, n: int, white: bool) -> str:
    if white:
        return f"The residuals are white over {n} frames: no parameter drift is visible (least white: {symbol}, {probability(p)})."
    return (
        f"The residuals are not white over {n} frames ({probability(p)}): those along {symbol} are correlated in time, as when "
        "the camera drifts with temperature or stars have wrong positions; the sigmas do not include this."
    )


MOST_POINTS = 1000
#: So few values have no order to speak of.
FEWEST_FOR_RUNS = 20


def nis_over_time(fitted: FittedSet) -> NisOverTime:
    """Innovations, or a batch's chi-squares, per degree of freedom, with their bounds."""
    frame, values, dof = _series(fitted)
    tail = (1 - CONFIDENCE) / 2
    per_dof, beyond = values / dof, chdtrc(dof, values)
    outside = float(np.mean((beyond > 1 - tail) | (beyond < tail)))
    low, high = share_bounds(len(values), 1 - CONFIDENCE, 1 - UNLIKELY)
    runs = runs_p_value(per_dof) if len(values) >= FEWEST_FOR_RUNS else 1.0
    shown = _thin(per_dof)
    lower, upper = (chdtri(dof[shown], share) / dof[shown] for share in (1 - tail, tail))
    return NisOverTime(
        frame=frame[shown].tolist(),
        nis_per_dof=nested(per_dof[shown]),
        lower=nested(lower),
        upper=nested(upper),
        outside_share=outside,
        expected_share=1 - CONFIDENCE,
        outside_bounds=[low, high],
        runs_p=runs,
        points_in_all=len(values),
        consistent=low <= outside <= high and runs >= UNLIKELY,
        sentence=_innovations_sentence(len(values), outside, (low, high), runs, fitted.estimate.history is not None),
    )


def _thin(values: FloatArray) -> NDArray[np.int64]:
    """Places to draw: all, or of a long series the lowest and the highest of each stretch, so that no outlier is lost."""
    if len(values) <= MOST_POINTS:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), MOST_POINTS // 2 + 1).astype(np.int64)
    stretches = [(first, values[first:last]) for first, last in pairwise(edges.tolist())]
    return np.unique([first + end for first, part in stretches for end in (np.argmin(part), np.argmax(part))])


def _series(fitted: FittedSet) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Frame numbers, sums of squares and their degrees of freedom, (n,) each."""
    history, updated = fitted.estimate.history, fitted.estimate.updated
    if history is not None and updated is not None:
        took = history.dof > 0  # an update whose measurements were all left out says nothing
        if not took.any():
            raise Unavailable("The filter used no frame: check sensor and matches.")
        return updated[took], history.nis[took], history.dof[took].astype(float)
    if fitted.sums.dof.min() < 1:
        raise Unavailable(
            "One frame alone determines most of the parameters, so it cannot be checked against the rest: add frames."
        )
    return fitted.arcs.frame, fitted.sums.chi2, fitted.sums.dof


def _innovations_sentence(n: int, outside: float, bounds: tuple[float, float], runs: float, filtered: bool) -> str:
    what = "updates" if filtered else "frames"
    share = f"{outside:.1%} of {n} {what} lie outside their 95 % bounds ({bounds[0]:.1%} to {bounds[1]:.1%} expected by chance)"
    wrong = "" if bounds[0] <= outside <= bounds[1] else ": the noise or the covariance is not as stated"
    if n < FEWEST_FOR_RUNS:
        return f"{share}{wrong}."
    order = (
        "are in random order" if runs >= UNLIKELY else "are not in random order, so something changed during the set"
    )
    return f"{share}{wrong}; high and low {what} {order} ({probability(runs)})."


MOST_SHOWN = 200
#: Deviate beyond which a frame is called badly explained: one in 740 by chance.
BAD = 3.0


def worst_frames(fitted: FittedSet) -> WorstFrames:
    """At most `MOST_SHOWN` frames, the worst first."""
    chi2, dof = fitted.sums.chi2, fitted.sums.dof
    judged = np.flatnonzero(dof >= 1)
    if not len(judged):
        raise Unavailable(
            "One frame alone determines the parameters, so none can be checked against the rest: add frames."
        )
    deviate = deviates(chi2[judged], dof[judged])
    order = np.argsort(-deviate, kind="stable")[:MOST_SHOWN]
    shown, bad, expected = judged[order], int(np.sum(deviate > BAD)), len(judged) * float(ndtr(-BAD))
    return WorstFrames(
        frame=fitted.arcs.frame[shown].tolist(),
        chi2_per_dof=nested(chi2[shown] / dof[shown]),
        dof=nested(dof[shown]),
        deviation=nested(deviate[order]),
        frames_in_all=len(judged),
        beyond=bad,
        expected_beyond=expected,
        sentence=(
            f"{bad} of {len(judged)} frames {'deviates' if bad == 1 else 'deviate'} by more than {BAD:g} sigmas "
            f"({expected:.1f} expected by chance); the worst is frame {fitted.arcs.frame[shown[0]]}."
        ),
    )


def deviates(chi2: FloatArray, dof: FloatArray) -> FloatArray:
    """Chi-squares (n,) of so many degrees of freedom (n,) as normal deviates."""
    spread = 2 / (9 * dof)
    return np.asarray((np.cbrt(chi2 / dof) - (1 - spread)) / np.sqrt(spread))
