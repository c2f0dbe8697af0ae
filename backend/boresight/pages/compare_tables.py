"""The tables of a comparison as the page prints them: parameters, correlations, and all parameters together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boresight.services.comparisons import Comparison, joint
from boresight.verdicts.numbers import MISSING, fixed, number, parameter, plus_minus, sigmas

#: From here on a difference is marked: one of 370 is so large by chance.
FAR_SIGMAS = 3.0
#: Correlations that differ by less look alike.
ALIKE = 0.05
UNLIKELY = 0.01
#: Below this a p-value has left the range of floats.
SMALLEST_P = 1e-300


@dataclass(frozen=True)
class Cell:
    """One parameter of one run: its value, what it is against the reference, and whether that is far."""

    value: str
    note: str
    far: bool = False


@dataclass(frozen=True)
class ParameterLine:
    """One parameter, a cell a run."""

    name: str
    cells: Sequence[Cell]
    differs: bool


@dataclass(frozen=True)
class CorrelationLine:
    """A pair of parameters, a printed correlation a run."""

    names: tuple[str, str]
    values: Sequence[str]
    differs: bool


def parameter_lines(found: Comparison) -> list[ParameterLine]:
    """Print every parameter of every run."""
    lines = []
    for i, name in enumerate(found.names):
        values = [(one.result.get("parameters") or {}).get(name) for one in found.compared]
        cells = [_cell(found, i, k) for k in range(len(values))]
        lines.append(ParameterLine(name, cells, len(set(values)) > 1))
    return lines


def _cell(found: Comparison, i: int, k: int) -> Cell:
    """Print parameter i of run k."""
    name, result, base = found.names[i], found.compared[k].result, found.compared[found.reference]
    value, sigma = ((result.get(key) or {}).get(name) for key in ("parameters", "sigma"))
    printed = parameter(value, name) if sigma is None else plus_minus(value, name, sigma)
    held = "held fixed" if value is not None and sigma is None else ""
    against = found.contrasts[k]
    if k == found.reference:
        return Cell(printed, "reference, held fixed" if held else "reference")
    if against is None or not np.isfinite(against.difference[i]):
        return Cell(printed, held or MISSING)
    if np.isfinite(against.sigma[i]):
        apart = float(against.separation[i])
        return Cell(printed, f"{sigmas(apart)}{', held fixed' if held else ''}", abs(apart) > FAR_SIGMAS)
    spread = (base.result.get("sigma") or {}).get(name)
    if against.difference[i] == 0 or not spread:
        return Cell(printed, "alike" if against.difference[i] == 0 else held or MISSING)
    return Cell(printed, f"{fixed(against.difference[i] / spread, 2)} of the reference’s σ, not noise")


def correlation_lines(found: Comparison) -> list[CorrelationLine]:
    """Print the strong correlations."""
    lines = []
    for a, b, values in found.correlations():
        known = [value for value in values if value is not None]
        lines.append(CorrelationLine((a, b), [fixed(value, 2) for value in values], max(known) - min(known) > ALIKE))
    return lines


def together(found: Comparison) -> list[Cell]:
    """Print, a run, whether all its parameters together differ from the reference's."""
    cells = []
    for k, against in enumerate(found.contrasts):
        test = joint(against)
        if k == found.reference:
            cells.append(Cell("reference", ""))
        elif test is None:
            cells.append(Cell(MISSING, "no result yet" if against is None else "what differs is not noise"))
        else:
            far = test["p"] < UNLIKELY
            words = "differ" if far else "may be the same"
            cells.append(Cell(words, f"χ² {number(test['chi2'], 3)} of {test['dof']}, {_chance(test['p'])}", far))
    return cells


def _chance(p: float) -> str:
    """Print a p-value; of one too small for a float, a bound, for no chance is nought."""
    return f"p = {number(p, 2)}" if p >= SMALLEST_P else "p < 10⁻³⁰⁰"
