"""Tests between nested candidates.

Is the larger one's lower chi-square more than its further parameters take from noise alone?

Where the smaller candidate is right, the drop of chi-square D between the two is, over the noise's variance, chi-square with as
many degrees of freedom q as parameters were set free. The stated noise may be wrong by a factor, which would make such a test wrong
as well; so D is held against the noise that the richest candidate leaves, s^2 = chi2 / m with m degrees of freedom, and

    F = (D / q) / s^2      is Fisher's F with q and m degrees of freedom,

whatever the factor. With many arcs F is the chi-square difference test over s^2. A richest candidate that does not hold the lens
makes s^2 too large, and the tests cautious.

Many candidates are looked at. A p-value here is multiplied by how many tests of the kind there were (Bonferroni), so that the
chance of one false term in all is at most the level: a candidate is held against every one that contains it, those with one term
more share half of the level and those with several the other half, and each of C cameras has the C-th part. A right candidate is
therefore rejected with a chance of at most level / C, however many contain it, and one term costs little for what others add.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import betaln, chdtri
from scipy.stats import f as fisher

from boresight.calibration.choice.fits import FittedSubset
from boresight.calibration.choice.terms import Subset, list_subsets

#: Level of every decision.
LEVEL = 0.01


@dataclass(frozen=True)
class Noise:
    """Variance of the arcs over the stated one, as the richest candidate leaves it, with its degrees of freedom."""

    variance: float
    dof: int

    @property
    def as_stated(self) -> bool:
        """Whether the stated noise explains it, at the level."""
        low, high = (float(chdtri(self.dof, p)) / self.dof for p in (1 - LEVEL / 2, LEVEL / 2))
        return low <= self.variance <= high

    @property
    def scale(self) -> float:
        """Variance that weighs chi-square in BIC: the stated one unless that is rejected."""
        return 1.0 if self.as_stated else self.variance


@dataclass(frozen=True)
class NestedTest:
    """One comparison of nested candidates.

    `smaller`, `larger`: the two. `terms`: what the larger has more. `drop`: chi-square difference by the stated noise. `df`:
    further free parameters. `log_p`: natural logarithm of the p-value, for the strongest are below what a number holds.
    `looked_at`: how many such tests there were.
    """

    smaller: FittedSubset
    larger: FittedSubset
    terms: tuple[str, ...]
    drop: float
    df: int
    log_p: float
    looked_at: int = 1

    @property
    def p(self) -> float:
        """p-value of this test alone."""
        return math.exp(self.log_p)

    @property
    def log_corrected(self) -> float:
        """Logarithm of the p-value, corrected for the number of tests."""
        return min(0.0, self.log_p + math.log(self.looked_at))

    @property
    def p_corrected(self) -> float:
        """p-value, corrected for the number of tests."""
        return math.exp(self.log_corrected)

    @property
    def rejects(self) -> bool:
        """Whether the smaller candidate does not suffice."""
        return self.log_corrected < math.log(LEVEL)


@lru_cache(maxsize=1024)
def count_tests(smaller: Subset, *, terms: int) -> int:
    """How many tests a candidate's test against one with so many terms more counts as, in its camera; see above."""
    above = [len(one.terms) - len(smaller.terms) for one in list_subsets(smaller.camera) if one.contains(smaller)]
    one, several = above.count(1), sum(more > 1 for more in above)
    return one * (2 if several else 1) if terms == 1 else 2 * several


def nested_test(smaller: FittedSubset, larger: FittedSubset, noise: Noise, looked_at: int = 1) -> NestedTest:
    """Test whether what the larger candidate has more is needed."""
    df = larger.n_free - smaller.n_free
    drop = max(0.0, smaller.chi2 - larger.chi2)
    more = tuple(name for name in larger.subset.term_names if name not in smaller.subset.term_names)
    log_p = log_survival(drop / df / noise.variance, df, noise.dof)
    return NestedTest(smaller, larger, more, drop, df, log_p, looked_at)


@lru_cache
def critical_drop(noise: Noise, df: int, looked_at: int) -> float:
    """Drop of chi-square from which a test with so many further parameters, one of so many, rejects."""
    return float(fisher.isf(LEVEL / looked_at, df, noise.dof)) * df * noise.variance


#: Below it the library's logarithm is that of a number that may have become zero.
SAFE_LOG = -600.0


def log_survival(f: float, df: int, dof: float) -> float:
    """Logarithm of the probability that Fisher's F exceeds `f`, finite however small that is.

    With z = dof / (dof + df f) it is the incomplete beta function I_z(a, b), a = dof / 2 and b = df / 2, by its power series
    (DLMF 8.17.8)

        I_z(a, b) = z^a (1 - z)^b / (a B(a, b)) sum_n (a + b)_n / (a + 1)_n z^n.
    """
    found = float(fisher.logsf(f, df, dof))
    if found > SAFE_LOG:
        return found
    a, b, z = dof / 2, df / 2, max(dof / (dof + df * f), sys.float_info.min)
    n = np.arange(math.ceil(40.0 / -math.log(z)) + 40)
    total = 1.0 + np.cumprod((a + b + n) / (a + 1.0 + n) * z).sum()
    return float(a * math.log(z) + b * math.log1p(-z) - math.log(a) - betaln(a, b) + math.log(total))
