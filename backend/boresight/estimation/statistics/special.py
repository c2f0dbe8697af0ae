"""Tails and quantiles of the distributions that tests rest on, under the names that SciPy gives them.

They are SciPy's to a part in 10^11, for a few numbers of moderate size; whatever is larger is handed to SciPy itself. Importing
that takes a tenth of a second of processor time, a fifth of all that a short calibration imports, for some thirty numbers.

The incomplete gamma function is the series below its peak and Lentz's continued fraction above, the incomplete beta function the
latter (Press et al., "Numerical Recipes", 2007, 6.2 and 6.4); the factor before them is written by the distance from the peak,
which keeps its digits where both exponent and logarithm are large (Loader 2000)::

    x^a e^-x / Gamma(a + 1) = exp(-D(a, x) - delta(a)) / sqrt(2 pi a),       D = x - a - a ln(x / a),

delta(a) being what Stirling's formula leaves of ln Gamma(a + 1). Quantiles are Newton's steps, kept in the interval that is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, wraps
from statistics import NormalDist
from typing import Any

import numpy as np

#: Numbers of an array, and degrees of freedom or trials, beyond which SciPy is asked.
FEW, MODERATE = 64, 1e4
_SMALLEST, _ROUNDING = 1e-300, 1e-16


def _like_scipy(function: Callable[..., float]) -> Callable[..., Any]:
    """Let a function of numbers take arrays too, and leave what is much or large to SciPy."""
    one = lru_cache(512)(function)  # a worker asks for the same quantiles with every set

    @wraps(function)
    def called(*arguments: Any) -> Any:
        if all(isinstance(each, float | int) for each in arguments) and all(
            abs(each) <= MODERATE for each in arguments[:-1]
        ):
            return one(*map(float, arguments))
        shape = np.broadcast_shapes(*(np.shape(one) for one in arguments))
        few = math.prod(shape) <= FEW and all(np.max(np.abs(each), initial=0.0) <= MODERATE for each in arguments[:-1])
        if not few:
            from scipy import special  # noqa: PLC0415 - see above

            return getattr(special, function.__name__)(*arguments)
        if not shape:
            return one(*map(float, arguments))
        rows = zip(*(np.broadcast_to(one, shape).ravel().tolist() for one in arguments), strict=True)
        return np.array([one(*row) for row in rows], np.float64).reshape(shape)

    return called


def ndtr(x: Any) -> Any:
    """Chance that a standard normal is below x, a number or a few."""
    if np.ndim(x) == 0:
        return 0.5 * math.erfc(-float(x) * math.sqrt(0.5))
    return np.array([0.5 * math.erfc(-one * math.sqrt(0.5)) for one in np.ravel(x).tolist()]).reshape(np.shape(x))


def ndtri(p: float) -> float:
    """Quantile of the standard normal."""
    return NormalDist().inv_cdf(p)


@_like_scipy
def chdtrc(dof: float, x: float) -> float:
    """Chance that chi-square exceeds x."""
    if not dof >= 0 or math.isnan(x):
        return math.nan
    if dof == 0:
        return 0.0 if x > 0 else math.nan
    return 1.0 if x == 0 else math.nan if x < 0 else 0.0 if math.isinf(x) else _gamma_tail(dof / 2, x / 2)


@_like_scipy
def chdtri(dof: float, p: float) -> float:
    """Value that chi-square exceeds with chance p."""
    if not (dof > 0 and 0 <= p <= 1):
        return math.nan
    if p in (0.0, 1.0):
        return math.inf if p == 0 else 0.0
    start = dof * max(1 - 2 / (9 * dof) - NormalDist().inv_cdf(p) * math.sqrt(2 / (9 * dof)), 1e-3) ** 3
    return _solved(
        lambda x: _gamma_tail(dof / 2, x / 2) - p, lambda x: -_gamma_peak(dof / 2, x / 2) * dof / 2 / x, start
    )


@_like_scipy
def bdtr(k: float, n: float, p: float) -> float:
    """Chance of at most k successes in n trials of chance p each."""
    k = math.floor(k)
    if not 0 <= k < n:
        return 1.0 if k == n else math.nan
    if n > FEW:
        return _beta(n - k, k + 1, 1 - p)
    return math.fsum(math.comb(int(n), i) * p**i * (1 - p) ** (n - i) for i in range(k + 1))  # no rounding at one half


@_like_scipy
def bdtrc(k: float, n: float, p: float) -> float:
    """Chance of more than k successes in n trials of chance p each."""
    k = math.floor(k)
    return 1.0 if k < 0 else math.nan if k > n else 0.0 if k == n else _beta(k + 1, n - k, p)


@_like_scipy
def stdtrit(dof: float, p: float) -> float:
    """Quantile of Student's distribution, for p above one half."""

    def above(t: float) -> float:
        return 1 - p - 0.5 * _beta(dof / 2, 0.5, dof / (dof + t * t))

    log = math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2) - 0.5 * math.log(dof * math.pi)
    return _solved(above, lambda t: math.exp(log - (dof + 1) / 2 * math.log1p(t * t / dof)), NormalDist().inv_cdf(p))


@_like_scipy
def fdtrc(first: float, second: float, x: float) -> float:
    """Chance that a value of the F distribution exceeds x."""
    return _beta(second / 2, first / 2, second / (second + first * x)) if x > 0 else 1.0


@_like_scipy
def fdtri(first: float, second: float, p: float) -> float:
    """Quantile of the F distribution."""
    a, b = first / 2, second / 2

    def above(x: float) -> float:
        return _beta(a, b, a * x / (a * x + b)) - p

    def density(x: float) -> float:
        share = a * x / (a * x + b)
        return math.exp(a * math.log(share) + b * math.log1p(-share) - _log_beta(a, b)) / x

    return _solved(above, density, 1.0)


def _solved(function: Callable[[float], float], slope: Callable[[float], float], x: float) -> float:
    """Root x > 0 of a monotonic function."""
    low, high = 0.0, math.inf
    rises = slope(x) > 0
    for _ in range(200):
        value = function(x)
        low, high = (low, x) if (value > 0) == rises else (x, high)
        steep = slope(x)
        after = x - value / steep if steep else math.nan
        if not low < after < high:
            after = 2 * x if math.isinf(high) else (low + high) / 2
        if abs(after - x) <= 1e-13 * x:  # what is left after such a step is rounding
            return after
        x = after
    return x


def _gamma_peak(a: float, x: float) -> float:
    """x^a e^-x / Gamma(a + 1)."""
    if a < 10:
        return math.exp(a * math.log(x) - x - math.lgamma(a + 1))
    off = (x - a) / a
    distance = a * (off - math.log1p(off)) if off > -0.999 else x - a - a * math.log(x / a)
    left = (1 / 12 - (1 / 360 - (1 / 1260 - (1 / 1680 - 1 / 1188 / a**2) / a**2) / a**2) / a**2) / a
    return math.exp(-distance - left) / math.sqrt(2 * math.pi * a)


def _gamma_tail(a: float, x: float) -> float:
    """Upper regularised incomplete gamma function Q(a, x)."""
    peak = _gamma_peak(a, x)
    if x < a + 1:
        term = total = 1.0
        n = a
        while term > total * _ROUNDING:
            n += 1
            term *= x / n
            total += term
        return 1 - peak * total
    return peak * a / _fraction(lambda i: (-i * (i - a), x + 2 * i + 1 - a), x + 1 - a)


def _beta(a: float, b: float, x: float) -> float:
    """Regularised incomplete beta function I_x(a, b)."""
    if x <= 0 or x >= 1:
        return float(x >= 1)
    if x > (a + 1) / (a + b + 2):
        return 1 - _beta(b, a, 1 - x)

    def term(i: int) -> tuple[float, float]:
        m = i // 2
        if i % 2:
            return -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)), 1.0
        return m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)), 1.0

    front = math.exp(a * math.log(x) + b * math.log1p(-x) - _log_beta(a, b)) / a
    return front / _fraction(term, 1.0)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


def _fraction(term: Callable[[int], tuple[float, float]], first: float) -> float:
    """Value of the continued fraction first + n_1 / (d_1 + n_2 / (d_2 + ...)), term(i) = (n_i, d_i)."""
    value = c = first or _SMALLEST
    d = 0.0
    for i in range(1, 100_000):
        above, below = term(i)
        d = 1 / (below + above * d or _SMALLEST)
        c = below + above / c or _SMALLEST
        value *= c * d
        if abs(c * d - 1) < _ROUNDING * 2:
            break
    return value
