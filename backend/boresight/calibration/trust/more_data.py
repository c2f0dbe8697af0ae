"""What more data would buy: predicted sigma against further frames of the same kind.

How it follows is told in `estimation.prediction`. "Of the same kind" means as many stars, as well spread, seen as sharply: the mean
information of the frames that are there. Where a set is short or covers little sky, further frames bring other stars and the
prediction is only as good as the sample; `benchmarks/more_data.py` checks it by running the frames.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.calibration.trust.ground import Ground, Unavailable, nested
from boresight.estimation.prediction import further_covariance

#: Further frames as shares of those that are there.
SHARES = (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def more_data(ground: Ground) -> dict[str, Any]:
    """Predicted one-sigma of each free parameter, SI."""
    if not ground.determined:
        raise Unavailable(
            "More frames of the same kind would leave the same direction open: turn the sensor, or hold it fixed."
        )
    n = ground.arcs.n_frames
    frames = sorted({round(share * n) for share in SHARES})
    noise, forgetting = 0.0, 1.0
    if ground.settings.sequential:
        noise, forgetting = ground.settings.process_noise, ground.settings.forgetting_factor
    P = [further_covariance(ground.estimate.P, ground.estimate.A / n, k, noise, forgetting) for k in frames]
    sigma = np.sqrt(np.array([np.diag(matrix) for matrix in P]))
    shown = sigma * ground.parameters.scale
    return {
        "frames": n,
        "further_frames": frames,
        "sigma": {name: nested(shown[:, i]) for i, name in enumerate(ground.names)},
        "sentence": _sentence(ground, frames, sigma),
    }


def _sentence(ground: Ground, frames: list[int], sigma: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    """What twice the data would buy for the parameter that is known least."""
    least = int(np.argmax(sigma[0]))
    double, most = frames.index(ground.arcs.n_frames), len(frames) - 1
    symbol = ground.symbols[least]
    gain = 1 - sigma[:, least] / sigma[0, least]
    return (
        f"{frames[double]} further frames of the same kind would lower the sigma of {symbol}, the parameter known least "
        f"beside its typical sigma, by {gain[double]:.0%}, and {frames[most]} by {gain[most]:.0%}."
    )
