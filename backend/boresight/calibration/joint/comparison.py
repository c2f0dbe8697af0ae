"""Drift, steps or walk: which kind of change the passes speak for.

A slow drift looks like steps to a search that knows steps alone, and a walk like both. So all are held against the same passes, at
one linearisation and with the temperature's part in each where it is known: nothing beside it, a line in time, the steps that are
beyond chance, and a random walk at its most likely drift. Each has its deviance, -2 log of the likelihood at its best values up to
a constant that all share, for which the steps of a walk are integrated over (`estimation.walk`), and

    BIC = deviance + parameters log(n)        n the passes times the parameters that vary

A step counts twice, for its size and its date. BICs that are nearer than `TOLD_APART` tell nothing (Kass and Raftery 1995: a
difference of 2 is worth no more than a bare mention).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from boresight.arrays import FloatArray, IntArray
from boresight.calibration.calibration import ComparedChange
from boresight.calibration.joint.change import Step, link_steps, noise_variance
from boresight.calibration.joint.passes_fit import PassesFit, PassesProblem
from boresight.estimation.block_bordered import Regressed
from boresight.estimation.change import LEVEL, Equations, step_falls
from boresight.estimation.walk import STARTS, WalkedPasses, most_likely

TOLD_APART = 2.0
#: Fewest passes that are compared, and most steps that are sought.
FEWEST_PASSES, MOST_STEPS = 6, 10
#: What each kind is called in a sentence.
CALLED = {"none": "no change in time", "drift": "a drift", "steps": "steps", "walk": "a random walk"}


class _Compared(NamedTuple):
    """Passes at one linearisation, the columns that all kinds have, and the noise's variance over the stated one."""

    equations: Equations
    base: Regressed
    variance: float

    def deviance(self, more: Regressed) -> float:
        """Of the base and further columns."""
        A, r = self.equations.A, self.equations.r
        B = self.beside(more).design(A.shape[1])
        h = np.einsum("kij,ki->j", B, r)
        return -float(h @ np.linalg.solve(np.einsum("kij,kil,klm->jm", B, A, B), h))

    def beside(self, more: Regressed) -> Regressed:
        """The base with further columns."""
        return Regressed(
            np.concatenate([self.base.of, more.of]), np.concatenate([self.base.values, more.values], axis=1)
        )

    def find_steps(self, own: IntArray) -> Regressed:
        """Seek steps one after the other, until none is beyond chance."""
        n_passes, n = self.equations.r.shape
        steps: list[Step] = []
        while True:
            link = link_steps(n_passes, steps)
            if len(steps) == MOST_STEPS:
                return link
            B = self.beside(link).design(n)
            falls = {int(place): step_falls(self.equations, B, int(place)) for place in own}
            place = max(falls, key=lambda one: float(falls[one].fall.max()))
            if not len(own) * falls[place].p_value(self.variance) < LEVEL:
                return link
            steps.append(Step(place, int(falls[place].fall.argmax())))


def compare_changes(
    of: PassesProblem, fitted: PassesFit, own: IntArray, days: FloatArray
) -> list[ComparedChange] | None:
    """Compare the kinds of change of the parameters at the places `own`, the likeliest first; None where passes are too few."""
    n_passes, z = len(of.passes), of.departures(fitted)
    if n_passes < FEWEST_PASSES or not np.ptp(days):
        return None
    warm = np.array([np.nan if one.temperature_c is None else one.temperature_c for one in of.passes])
    known = np.isfinite(warm).all() and np.ptp(warm) > 0.0
    base = Regressed(
        own[:0] if not known else own, np.tile((warm - warm.mean())[:, None], (1, len(own) if known else 0))
    )
    at = _Compared(Equations.of(fitted.sums, z), base, noise_variance(of, fitted.chi2, 0))
    line = Regressed(own, np.tile((days - days.mean())[:, None] / np.ptp(days), (1, len(own))))
    steps, none = at.find_steps(own), link_steps(n_passes, [])
    passes = WalkedPasses(fitted.sums, z, own, np.maximum(np.diff(days), 0.0), base if known else None)
    sigma = most_likely(passes, [np.full(len(own), start) for start in STARTS])
    tried = {
        "none": (at.deviance(none), 0),
        "drift": (at.deviance(line), len(own)),
        "steps": (at.deviance(steps), 2 * len(steps.of)),
        "walk": (passes.deviance(sigma), len(own)),
    }
    least = min(deviance for deviance, _ in tried.values())
    told = [
        ComparedChange(
            kind=kind,
            parameters=parameters,
            deviance=deviance - least,
            bic=deviance - least + parameters * float(np.log(n_passes * len(own))),
        )
        for kind, (deviance, parameters) in tried.items()
    ]
    return sorted(told, key=lambda one: one.bic)


def say_comparison(compared: list[ComparedChange]) -> str:
    """Say which kind of change is the likeliest."""
    first, second = compared[0], compared[1]
    apart = second.bic - first.bic
    if apart < TOLD_APART:
        return f"these passes cannot distinguish {CALLED[first.kind]} from {CALLED[second.kind]}"
    return f"these passes favour {CALLED[first.kind]} (BIC lower by {apart:.3g} than for {CALLED[second.kind]})"
