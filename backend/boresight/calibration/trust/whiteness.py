"""Whether the residuals change with time: the scores of the frames tell, parameter by parameter.

A camera that drifts by dz_k in parameter p leaves in frame k the score b_kp = (H_k^T e_k)_p = A_kpp dz_k + noise of variance
A_kpp. Over

    y_kp = b_kp / sqrt(A_kpp)

the noise has variance one in every frame, however many stars it has, and the drift stands out as far as one parameter's
residual can show it; a sum of squares would not see its sign. At a constant camera y_kp is white over k. Ljung and Box's test
(estimation.consistency) is made of each free parameter, and the least p-value counts, times their number (Bonferroni). Below 1
% the series is not white.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, nested, probability
from boresight.estimation.statistics.consistency import ljung_box

FEWEST_FRAMES = 20
MOST_LAGS = 20
#: Lags that the test sums: a drift shows in the first, and with twenty Q is far from chi-square at a few hundred frames.
TESTED_LAGS = 5
#: Chance of so much autocorrelation at a constant camera below which the residuals are not called white.
UNLIKELY = 0.01


def whiteness(fitted: FittedSet) -> dict[str, Any]:
    """Autocorrelation of the least white score, and the test over all of them."""
    n = fitted.arcs.n_frames
    if n < FEWEST_FRAMES:
        raise Unavailable(f"A series needs {FEWEST_FRAMES} frames before it can be told from noise; there are {n}.")
    y = np.ascontiguousarray((fitted.sums.scores / np.sqrt(np.maximum(fitted.sums.squares, np.finfo(float).tiny))).T)
    lags = min(MOST_LAGS, n // 5)
    tests = [ljung_box(series, min(TESTED_LAGS, lags)) for series in y]
    least = int(np.argmin([test.p for test in tests]))
    p = min(1.0, tests[least].p * len(tests))
    return {
        "lags": list(range(1, lags + 1)),
        "autocorrelation": nested(ljung_box(y[least], lags).autocorrelation),
        "bound": float(1.96 / np.sqrt(n)),
        "name": fitted.names[least],
        "ljung_box": {"value": tests[least].value, "dof": tests[least].dof, "p": p},
        "p_of_parameters": {name: test.p for name, test in zip(fitted.names, tests, strict=True)},
        "white": p >= UNLIKELY,
        "sentence": _sentence(fitted.symbols[least], p, n, p >= UNLIKELY),
    }


def _sentence(symbol: str, p: float, n: int, white: bool) -> str:
    """The verdict in words."""
    if white:
        return (
            f"The residuals are white over {n} frames: no parameter is seen to drift ({probability(p)} for the least white, "
            f"{symbol})."
        )
    return (
        f"The residuals are not white over {n} frames ({probability(p)}): those along {symbol} follow one another, as when "
        "the camera drifts with temperature or stars keep wrong places; the sigmas leave this out."
    )
