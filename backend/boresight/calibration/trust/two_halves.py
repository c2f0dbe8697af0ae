"""Two halves of a set, fitted apart: whether they agree within what both claim.

The frames are cut into some 40 consecutive blocks, dealt out in turn, so that both halves cover the same sky, temperatures and
time. Each is fitted alone from the joint estimate. Their data are independent, so the difference d = x_a - x_b has covariance
P_a + P_b, and

    d^T (P_a + P_b)^-1 d     is chi-square with n_free degrees of freedom

when stars, noise and model are what they are said to be. It is not, when some frames hold wrong matches, when the noise is
understated or when the camera changed from block to block. What neither half can show is an error both share: a model that is
wrong everywhere. Whatever the method, the halves are fitted by the batch estimator, without any start's information.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from boresight.arrays import FloatArray
from boresight.calibration.estimate import covariance
from boresight.calibration.trust.fitted_set import ARCSEC, FittedSet, Unavailable, chosen, grid, nested, probability
from boresight.estimation import batch
from boresight.estimation.statistics.consistency import chi_square
from boresight.estimation.statistics.uncertainty import difference_over_detector, expected_difference

BLOCKS = 40
ROWS, COLUMNS = 13, 17
MOST_ITERATIONS = 20


def two_halves(fitted: FittedSet) -> dict[str, Any]:
    """Fit both halves and compare them."""
    if not fitted.determined:
        raise Unavailable(
            "The whole set does not determine every free parameter, so neither does a half: hold some fixed."
        )
    n = fitted.arcs.n_frames
    if n < 2:
        raise Unavailable("One frame has no halves: add frames.")
    in_first = (np.arange(n) * min(n, BLOCKS) // n) % 2 == 0
    first, second = _fitted(fitted, in_first), _fitted(fitted, ~in_first)
    return _compared(fitted, first, second)


def _fitted(ground: FittedSet, frames: NDArray[np.bool_]) -> batch.BatchFit:
    """Fit some frames alone."""
    arcs = chosen(ground.arcs, frames)
    if arcs.n_arcs <= len(ground.names):
        raise Unavailable("A half of the set holds no more arcs than there are free parameters: add frames.")
    fitted = batch.fit(
        arcs, ground.x, ground.parameters.free, ground.parameters.scale,
        threshold=ground.threshold, max_iterations=MOST_ITERATIONS,
    )  # fmt: skip
    if fitted.status != "converged":
        raise Unavailable(
            "A half of the set does not determine the free parameters by itself: add frames, or free fewer."
        )
    return fitted


def _compared(fitted: FittedSet, first: batch.BatchFit, second: batch.BatchFit) -> dict[str, Any]:
    """Their difference in units of its covariance, and over the detector."""
    scale = fitted.parameters.scale
    P = covariance(first.A) + covariance(second.A)
    d = (first.x - second.x)[fitted.parameters.free] / scale
    dof, value = len(d), float(d @ np.linalg.solve(P, d))
    test = chi_square(value, dof)
    sensor, camera = fitted.problem.sensor, fitted.problem.camera
    row, col = grid(sensor.rows, sensor.columns, ROWS, COLUMNS)
    places = (np.repeat(row, COLUMNS), np.tile(col, ROWS))
    difference = ARCSEC * difference_over_detector(camera, first.x, second.x, places, sensor.pixel_pitch_m)
    expected = ARCSEC * expected_difference(camera, fitted.x, fitted.full_covariance(P), places, sensor.pixel_pitch_m)
    return {
        "names": fitted.names,
        "difference_in_sigma": nested(d / np.sqrt(np.diag(P))),
        "chi2": {
            "value": value,
            "dof": dof,
            "lower": test.lower * dof,
            "upper": test.upper * dof,
            "p": float(chdtrc(dof, value)),
            "consistent": test.consistent,
        },
        "map": {
            "row_px": nested(row),
            "col_px": nested(col),
            "difference_arcsec": nested(difference.reshape(ROWS, COLUMNS)),
            "expected_arcsec": nested(expected.reshape(ROWS, COLUMNS)),
        },
        "sentence": _sentence(value, dof, (test.lower * dof, test.upper * dof), _rms(difference), _rms(expected)),
    }


def _rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _sentence(value: float, dof: int, bounds: tuple[float, float], found: float, expected: float) -> str:
    """The verdict in words."""
    lower, upper = bounds
    numbers = (
        f"chi-square {value:.3g} for {dof}, {lower:.2g} to {upper:.3g} expected, {probability(chdtrc(dof, value))}"
    )
    over = f"over the detector they differ by {found:.2g} arcsec (rms), {expected:.2g} expected"
    if value > upper:
        return (
            f"Two halves of the set disagree by more than their sigmas allow ({numbers}); {over}: "
            "look for wrong matches, understated noise or a camera that changed."
        )
    if value < lower:
        return (
            f"Two halves of the set agree better than their sigmas allow ({numbers}); {over}: the noise is overstated."
        )
    return f"Two halves of the set, fitted apart, agree ({numbers}); {over}."
