"""Tests between nested candidates.

Is the larger one's lower chi-square more than its further parameters take from noise alone?

Where the smaller candidate is right, the drop of chi-square D between the two is, over the noise's variance, chi-square with as
many degrees of freedom q as parameters were set free. The stated noise may be wrong by a factor, which would make such a test wrong
as well; so D is held against the noise that the richest candidate leaves, s^2 = chi2 / m with m degrees of freedom, and

    F = (D / q) / s^2      is Fisher's F with q and m degrees of freedom,

whatever the factor. With many arcs F is the chi-square difference test over s^2. A richest candidate that does not hold the lens
makes s^2 too large, and the tests cautious.

Many candidates are looked at. A p-value here is multiplied by how many tests of the kind there were (Bonferroni), so that the
chance of one false term in all is at most the level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import chdtri
from scipy.stats import f as fisher

from boresight.calibration.choice.fits import FittedSubset

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
        """Logarithm of the p-value that counts how many tests were looked at."""
        return min(0.0, self.log_p + math.log(self.looked_at))

    @property
    def p_corrected(self) -> float:
        """p-value that counts how many tests were looked at."""
        return math.exp(self.log_corrected)

    @property
    def rejects(self) -> bool:
        """Whether the smaller candidate does not suffice."""
        return self.log_corrected < math.log(LEVEL)


def nested_test(smaller: FittedSubset, larger: FittedSubset, noise: Noise, looked_at: int = 1) -> NestedTest:
    """Test whether what the larger candidate has more is needed."""
    df = larger.n_free - smaller.n_free
    drop = max(0.0, smaller.chi2 - larger.chi2)
    more = tuple(name for name in larger.subset.term_names if name not in smaller.subset.term_names)
    log_p = float(fisher.logsf(drop / df / noise.variance, df, noise.dof))
    return NestedTest(smaller, larger, more, drop, df, log_p, looked_at)


def least_likely(tests: list[NestedTest]) -> NestedTest | None:
    """Return the test with the smallest p-value; of p-values too small to tell, the one with the largest drop."""
    return min(tests, key=lambda test: (test.log_p, -test.drop), default=None)
