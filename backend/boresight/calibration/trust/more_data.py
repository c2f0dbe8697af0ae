"""What more data would buy: predicted sigma against further frames of the same kind.

How it follows is told in `estimation.statistics.observability`. "Of the same kind" means as many stars, as well spread, seen as
sharply: the
mean information of the frames that are there. Where a set is short or covers little sky, further frames bring other stars and
the prediction is only as good as the sample. How unlike its parts are tells how good: the set is cut into `BLOCKS` runs of
frames, each is left out in turn, and the jackknife gives the relative uncertainty of the sigma that many further frames would
leave,

    s^2 = (B - 1) / B  sum_b (ln sigma_b - mean ln sigma)^2,        sigma_b^2 = diag((A - A_b) / (n - n_b))^-1.

`python -m benchmarks.monte_carlo more-data` checks the prediction by running the frames.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.arrays import FloatArray
from boresight.calibration.trust.fitted_set import FittedSet, Unavailable, nested
from boresight.estimation import batch
from boresight.estimation.statistics.observability import further_covariance

#: Share of a sigma that twenty times the data must lower it by, to be worth speaking of.
LITTLE = 0.3
#: Parts of the set that are left out in turn.
BLOCKS = 20
#: Further frames as shares of those that are there.
SHARES = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def more_data(fitted: FittedSet) -> dict[str, Any]:
    """Predicted one-sigma of each free parameter, SI."""
    if not fitted.determined:
        raise Unavailable(
            "More frames of the same kind would leave the same direction open: turn the sensor, or hold it fixed."
        )
    n = fitted.arcs.n_frames
    frames = sorted({round(share * n) for share in SHARES})
    noise, forgetting = 0.0, 1.0
    if fitted.settings.sequential:
        noise, forgetting = fitted.settings.process_noise, fitted.settings.forgetting_factor
    doubt = _doubt(fitted)
    P = [further_covariance(fitted.estimate.P, fitted.estimate.A / n, k, noise, forgetting) for k in frames]
    sigma = np.sqrt(np.array([np.diag(matrix) for matrix in P]))
    shown = sigma * fitted.parameters.scale
    return {
        "frames": n,
        "further_frames": frames,
        "sigma": {name: nested(shown[:, i]) for i, name in enumerate(fitted.names)},
        "relative_uncertainty": None if doubt is None else dict(zip(fitted.names, nested(doubt), strict=True)),
        "sentence": _sentence(fitted, frames, sigma, doubt),
    }


def _doubt(fitted: FittedSet) -> FloatArray | None:
    """Relative uncertainty (n_free,) of the predicted sigmas; None where the blocks are too few or too thin."""
    n = fitted.arcs.n_frames
    blocks = min(n, BLOCKS)
    if blocks < 3:
        return None
    block = np.arange(n) * blocks // n
    starts = fitted.arcs.frame_arcs
    cuts = starts[np.searchsorted(block, np.arange(blocks + 1))]
    logs = []
    for b in range(blocks):
        H = fitted.H[cuts[b] : cuts[b + 1]]
        left = (fitted.A - H.T @ H) / (n - np.sum(block == b))
        if not batch.determined(left)[2].all():
            return None
        logs.append(np.log(np.diag(np.linalg.inv(left))) / 2)
    return np.asarray(np.sqrt((blocks - 1) * np.var(logs, axis=0)))


def _sentence(fitted: FittedSet, frames: list[int], sigma: FloatArray, doubt: FloatArray | None) -> str:
    """What twice the data would buy for the parameter that is known least."""
    least = int(np.argmax(sigma[0]))
    double, most = frames.index(fitted.arcs.n_frames), len(frames) - 1
    symbol = fitted.symbols[least]
    gain = 1 - sigma[:, least] / sigma[0, least]
    if gain[most] < LITTLE:
        return (
            f"A filter that forgets knows what its last frames told it: even {frames[most]} further frames of the same kind would "
            f"lower the sigma of {symbol} by {gain[most]:.0%} only."
        )
    unlike = (
        "" if doubt is None else f"; judged by how unlike its parts are, it may be {doubt[least]:.0%} off (1 sigma)"
    )
    return (
        f"{frames[double]} further frames of the same kind would lower the sigma of {symbol}, the parameter known least "
        f"beside its typical sigma, by {gain[double]:.0%}, and {frames[most]} by {gain[most]:.0%}{unlike}."
    )
