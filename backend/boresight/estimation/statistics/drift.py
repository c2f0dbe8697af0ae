"""Do the parameters still hold? One estimate against a baseline, and a series of estimates against time.

Let theta_i (k) be estimates of the same k parameters from data that do not overlap, with covariances P_i, made of data of
the times t_i and, where it is known, at the temperatures T_i.

**Does the baseline hold?** If nothing changed, the newest estimate theta_n and the baseline theta_b differ by their errors
only. They are independent, so d = theta_n - theta_b has the covariance P_n + P_b, and

    D^2 = d^T (P_n + P_b)^-1 d

is chi-square with k degrees of freedom (Mahalanobis 1936). Every correlation is in it: parameters that trade against each
other, as a focal length and a distortion do, may both move by several sigmas and say nothing, or by half a sigma each in a
direction that is well determined and say much.

**Is there a slope?** With u_i = t_i - t_mean and v_i = T_i - T_mean

    theta_i = a + s u_i + c v_i + e_i,      e_i ~ N(0, P_i),

is linear in the 2k or 3k unknowns. Whitened by the Cholesky factors of the P_i it is one least-squares problem; its inverse
normal matrix is the covariance, and s^T C_s^-1 s is chi-square with k degrees of freedom when s = 0. What is left of the sum
of squares is chi-square with m k minus the unknowns. Where it is more than its degrees of freedom, the estimates scatter
more than they say: then C is multiplied by that ratio (Birge 1932), which can only make the test slower to reject.

Both are asked at once, so each gets its share of the false-alarm rate alpha: with two tests alpha / 2 (Bonferroni), and the
chance that either rejects although nothing changed is alpha at most.

How much a test can see is its power: when d has the true mean delta, D^2 is noncentral chi-square with the noncentrality
delta^T (P_n + P_b)^-1 delta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri, chndtr

from boresight.arrays import FloatArray

FALSE_ALARM_RATE = 0.001
FEWEST_FOR_A_LINE = 3
FEWEST_FOR_TEMPERATURE = 4
LEAST_SPREAD_C = 1.0  # temperatures nearer together than this tell nothing of their effect


@dataclass(frozen=True)
class Epoch:
    """An estimate from the data of one time.

    Parameters
    ----------
    t_d
        Middle of the data [d].
    value
        (k,) parameters, SI.
    covariance
        (k, k).
    temperature_c
        Middle of the data's range; NaN where it is not known.
    """

    t_d: float
    value: FloatArray
    covariance: FloatArray
    temperature_c: float = float("nan")


@dataclass(frozen=True)
class ChiSquareTest:
    """A sum of squares held against its chi-square distribution.

    Parameters
    ----------
    statistic, dof
        The sum and its degrees of freedom.
    limit
        What it exceeds with probability alpha although nothing changed.
    p
        The probability of so much or more although nothing changed.
    alpha
        The false-alarm probability of this test alone.
    """

    statistic: float
    dof: int
    limit: float
    p: float
    alpha: float

    @property
    def rejects(self) -> bool:
        """Whether it is too much for chance."""
        return self.statistic > self.limit


@dataclass(frozen=True)
class RegressionLine:
    """A weighted regression of estimates on time, and on temperature where it could be.

    Parameters
    ----------
    slope_per_d, slope_covariance
        (k,) change a day, SI, and its covariance (k, k).
    thermal_per_c, thermal_covariance
        (k,) change a degree and its covariance (k, k); None where temperature was left out.
    scatter, scatter_dof
        Sum of squares about the line, and its degrees of freedom.
    """

    slope_per_d: FloatArray
    slope_covariance: FloatArray
    thermal_per_c: FloatArray | None
    thermal_covariance: FloatArray | None
    scatter: float
    scatter_dof: int

    @property
    def inflation(self) -> float:
        """By how much the covariances were multiplied because the estimates scatter more than they say; at least one."""
        return max(1.0, self.scatter / self.scatter_dof)


def chi_square_test(statistic: float, dof: int, alpha: float) -> ChiSquareTest:
    """Hold a sum of squares against its distribution."""
    return ChiSquareTest(statistic, dof, float(chdtri(dof, alpha)), float(chdtrc(dof, statistic)), alpha)


def mahalanobis(difference: FloatArray, covariance: FloatArray) -> float | None:
    """Return d^T C^-1 d of d (k,) with C (k, k); None where C is no covariance."""
    scale = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and np.isfinite(difference).all() and (scale > 0).all()):
        return None
    try:
        L = np.linalg.cholesky(covariance / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return None
    return float(np.sum(np.linalg.solve(L, difference / scale) ** 2))


def baseline_test(newest: Epoch, baseline: Epoch, alpha: float = FALSE_ALARM_RATE) -> ChiSquareTest | None:
    """Test whether the baseline still holds; None where a covariance cannot be used."""
    statistic = mahalanobis(newest.value - baseline.value, newest.covariance + baseline.covariance)
    return None if statistic is None else chi_square_test(statistic, len(newest.value), alpha)


def slope_test(line: RegressionLine, alpha: float = FALSE_ALARM_RATE) -> ChiSquareTest | None:
    """Test whether the estimates move with time; None where the slope is not determined."""
    statistic = mahalanobis(line.slope_per_d, line.slope_covariance)
    return None if statistic is None else chi_square_test(statistic, len(line.slope_per_d), alpha)


def power(difference: FloatArray, covariance: FloatArray, alpha: float = FALSE_ALARM_RATE) -> float | None:
    """Return the chance that a true change (k,) is seen through an error of a covariance (k, k)."""
    noncentrality = mahalanobis(difference, covariance)
    if noncentrality is None:
        return None
    dof = len(difference)
    return float(1.0 - chndtr(float(chdtri(dof, alpha)), dof, noncentrality))


def fit_line(epochs: Sequence[Epoch]) -> RegressionLine | None:
    """Fit the estimates by a line in time; None where there are too few, or all of one time, or a covariance is none."""
    if len(epochs) < FEWEST_FOR_A_LINE:
        return None
    columns, units = _columns(epochs)
    scale = np.median([np.sqrt(np.diag(epoch.covariance)) for epoch in epochs], axis=0)
    if columns is None or not (np.isfinite(scale).all() and (scale > 0).all()):
        return None
    whitened = _whitened(epochs, columns, scale)
    return None if whitened is None else _solved(*whitened, units, scale)


def _columns(epochs: Sequence[Epoch]) -> tuple[FloatArray | None, FloatArray]:
    """Return one, time and perhaps temperature of each estimate (m, 2 or 3), in their own units (2 or 3,)."""
    t = np.array([epoch.t_d for epoch in epochs])
    T = np.array([epoch.temperature_c for epoch in epochs])
    columns, units = [np.ones(len(t)), t - t.mean()], [1.0, float(np.ptp(t)) / 2]
    if len(epochs) >= FEWEST_FOR_TEMPERATURE and np.isfinite(T).all() and np.ptp(T) >= LEAST_SPREAD_C:
        columns.append(T - T.mean())
        units.append(float(np.ptp(T)) / 2)
    if units[1] <= 0:
        return None, np.array(units)
    scaled = np.column_stack(columns) / np.array(units)
    if np.linalg.cond(scaled) > 1e6:  # temperature that goes with time cannot be told from it
        scaled, units = scaled[:, :2], units[:2]
    return scaled, np.array(units)


def _whitened(epochs: Sequence[Epoch], columns: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the stacked design (m k, n k) and values (m k,), each estimate whitened by its own covariance."""
    design, values = [], []
    for epoch, row in zip(epochs, columns, strict=True):
        try:
            L = np.linalg.cholesky(epoch.covariance / np.outer(scale, scale))
        except np.linalg.LinAlgError:
            return None
        design.append(np.linalg.solve(L, np.kron(row, np.eye(len(scale)))))
        values.append(np.linalg.solve(L, (epoch.value - epochs[0].value) / scale))
    return np.concatenate(design), np.concatenate(values)


@dataclass(frozen=True)
class _Solution:
    """The unknowns b (n k,) with their covariance C (n k, n k), widened by the scatter; the scatter and its degrees of freedom."""

    b: FloatArray
    C: FloatArray
    scatter: float
    dof: int


def _least_squares(X: FloatArray, y: FloatArray) -> _Solution | None:
    """Solve the stacked problem X b = y."""
    Q, R = np.linalg.qr(X)
    if np.abs(np.diag(R)).min() <= 1e-12 * np.abs(np.diag(R)).max():
        return None
    b = np.linalg.solve(R, Q.T @ y)
    scatter, dof = float(np.sum((y - X @ b) ** 2)), len(y) - len(b)
    half = np.linalg.inv(R)
    return _Solution(b, half @ half.T * max(1.0, scatter / dof), scatter, dof)


def _solved(X: FloatArray, y: FloatArray, units: FloatArray, scale: FloatArray) -> RegressionLine | None:
    """Solve the stacked problem X b = y and give the blocks their units back."""
    if (found := _least_squares(X, y)) is None:
        return None
    blocks = [_block(found.b, found.C, n, unit, scale) for n, unit in enumerate(units)]
    slope, thermal = blocks[1], blocks[2] if len(blocks) > 2 else (None, None)
    return RegressionLine(slope[0], slope[1], thermal[0], thermal[1], found.scatter, found.dof)


def _block(b: FloatArray, C: FloatArray, n: int, unit: float, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the n-th of the unknown vectors (k,) with its covariance (k, k), in SI."""
    part = slice(n * len(scale), (n + 1) * len(scale))
    return b[part] * scale / unit, C[part, part] * np.outer(scale, scale) / unit**2
