"""Is an estimate as good as it says? Chi-square tests of residuals, innovations and errors.

A sum of squares of m independent unit normal numbers is chi-square with m degrees of freedom. Three such sums matter:

- chi-square per degree of freedom of the whitened residuals, m = arcs - free parameters: is R right, does the model fit?
- NIS, the normalised innovations of a filter, m = arcs: does the filter predict the next frame as well as it claims?
- NEES, (x - truth)^T P^-1 (x - truth), m = free parameters: only where the truth is known, in simulation.

RMS proves none of this: on an 82 urad noise floor a filter five times worse than the bound raises RMS by 0.7 urad.

Whether a series is noise over time is another question, with three answers:

- the share of values outside 95 % bounds, against the binomial distribution of that share when all is well;
- runs (Wald & Wolfowitz 1940): values above and below the median should alternate as coin tosses do. With n_1 above and
  n_2 below, n in all, the number of runs has mean 1 + 2 n_1 n_2 / n and variance 2 n_1 n_2 (2 n_1 n_2 - n) / (n^2 (n - 1));
- autocorrelation r_l = sum_k y_k y_{k+l} / sum_k y_k^2, which for white noise is normal with variance (n - l) / (n (n + 2)), so
  that Q = n (n + 2) sum_l r_l^2 / (n - l) is chi-square with as many degrees of freedom as lags (Ljung & Box 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.arrays import FloatArray
from boresight.estimation.statistics.special import bdtr, chdtrc, chdtri, ndtr

CONFIDENCE = 0.95
#: Sigmas beyond which a single number is clear of zero; of what is Gaussian one in 370 is.
CLEAR_SIGMAS = 3.0


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares per degree of freedom, with the bounds it keeps when all is well.

    Parameters
    ----------
    mean
        Sum over dof.
    dof
        Degrees of freedom.
    lower, upper
        Two-sided 95 % bounds of the mean.
    """

    mean: float
    dof: int
    lower: float
    upper: float

    @property
    def consistent(self) -> bool:
        """Whether the mean lies inside its bounds."""
        return self.lower <= self.mean <= self.upper


def chi_square(total: float, dof: int) -> ChiSquare:
    """Test a sum of squares against its chi-square distribution.

    Raises
    ------
    ValueError
        When dof is not positive.
    """
    if dof <= 0:
        raise ValueError(f"Expected positive degrees of freedom, received {dof}")
    tail = (1 - CONFIDENCE) / 2
    return ChiSquare(total / dof, dof, float(chdtri(dof, 1 - tail)) / dof, float(chdtri(dof, tail)) / dof)


def nees(error: FloatArray, P: FloatArray) -> float:
    """Normalised estimation error squared, error (n,) against covariance P (n, n); its expectation is n."""
    return float(error @ np.linalg.solve(P, error))


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of a series, and how likely so much of it is by chance.

    Parameters
    ----------
    autocorrelation
        (n_lags,) r_1 ... r_n_lags.
    value, dof
        Q of Ljung and Box, and its degrees of freedom.
    p
        Chance of a Q as large when the series is white.
    """

    autocorrelation: FloatArray
    value: float
    dof: int
    p: float


def ljung_box(series: FloatArray, lags: int) -> Whiteness:
    """Test whether a series (n,) of zero mean is white.

    Raises
    ------
    ValueError
        When there are not more values than lags.
    """
    n = len(series)
    if not 0 < lags < n:
        raise ValueError(f"Expected fewer lags than values, at least one; received {lags} lags of {n} values")
    series = np.ascontiguousarray(series)
    products = np.array([series[: n - lag] @ series[lag:] for lag in range(lags + 1)])
    r = products[1:] / max(float(products[0]), np.finfo(float).tiny)
    value = float(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1))))
    return Whiteness(r, value, lags, float(chdtrc(lags, value)))


def runs_p_value(series: FloatArray) -> float:
    """Chance of as few or as many runs about the median of a series (n,) when its values are independent; 1 for a short one."""
    above = series[series != np.median(series)] > np.median(series)
    n, n_1 = len(above), int(above.sum())
    if n < 10 or n_1 in {0, n}:
        return 1.0
    pairs = 2.0 * n_1 * (n - n_1)
    variance = pairs * (pairs - n) / (n * n * (n - 1))
    runs = 1 + int(np.sum(above[1:] != above[:-1]))
    return float(2 * ndtr(-abs(runs - 1 - pairs / n) / np.sqrt(variance)))


def share_bounds(n: int, share: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Two-sided bounds of the share found among n when each is in with probability `share`."""
    tail = (1 - confidence) / 2
    counts = np.arange(n + 1)
    below = bdtr(counts.astype(float), n, share)
    return float(np.searchsorted(below, tail)) / n, float(np.searchsorted(below, 1 - tail)) / n
