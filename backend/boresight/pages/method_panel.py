"""The comparison of methods on one data set: error, cost, convergence and consistency, and when to use which.

Methods can be told apart only where all else is alike. Runs on different sets are refused; what else differs between the runs
is named above the table, so that nobody takes its effect for the method's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from boresight.calibration.options import ALL, METHODS, OPTIONS, is_sequential, title_of
from boresight.figures.course import SETTLED_SIGMAS
from boresight.figures.method_scores import MethodScores, method_scores
from boresight.pages.formats import words
from boresight.store.tables import Run
from boresight.verdicts.numbers import MISSING, count, fixed, number

#: Settings that are a method's own, and so belong to the comparison.
OWN = {"method", *(name for name, option in OPTIONS.items() if option.methods != ALL)}


class HasResult(Protocol):
    """A run with its result, empty where it has none."""

    @property
    def run(self) -> Run:
        """The run."""
        ...

    @property
    def result(self) -> Mapping[str, Any]:
        """Its calibration JSON."""
        ...


@dataclass(frozen=True)
class Line:
    """One row of the table: what is compared, its unit, a text a run, and how to read it."""

    name: str
    unit: str
    values: Sequence[str]
    reading: str


@dataclass(frozen=True)
class MethodPanel:
    """What the panel shows.

    Parameters
    ----------
    refusal
        Why methods cannot be told apart here, or None.
    unlike
        What else differs between the runs, in words; empty where nothing does.
    lines
        Rows of the table.
    when
        Title of each method and when to use it.
    """

    refusal: str | None
    unlike: str
    lines: Sequence[Line]
    when: Sequence[tuple[str, str]]


def method_panel(compared: Sequence[HasResult]) -> MethodPanel | None:
    """Set the methods of several runs beside each other; None where there is but one."""
    used = {one.run.method for one in compared}
    if len(used) < 2:
        return None
    when = [(method.title, method.when) for method in METHODS.values() if method.name in used]
    refusal = _refusal(compared)
    if refusal is not None:
        return MethodPanel(refusal, "", (), when)
    return MethodPanel(None, ", ".join(_unlike(compared)), _lines(compared), when)


def _refusal(compared: Sequence[HasResult]) -> str | None:
    """Say why the runs tell nothing of their methods, or None."""
    by_set = {one.run.telemetry_set_id: one.run.id for one in compared}
    if len(by_set) > 1:
        first, second = list(by_set.values())[:2]
        return (
            f"Run #{first} and run #{second} are of different telemetry sets, so their differences are not those of their"
            " methods: compare runs of one set."
        )
    if not any(one.result.get("parameters") for one in compared):
        return "None of these runs has a result yet: open this page again when they have ended."
    return None


def _unlike(compared: Sequence[HasResult]) -> list[str]:
    """Name the settings beyond the methods' own that are not the same in all runs."""
    names = sorted({name for one in compared for name in one.run.settings} - OWN - {"free"})
    found = [words(name) for name in names if len({str(one.run.settings.get(name)) for one in compared}) > 1]
    free = {str(one.result["free"]) for one in compared if one.result.get("free")}
    frames = {one.result["frames"] for one in compared if one.result.get("frames")}
    return found + ["free parameters"] * (len(free) > 1) + ["number of frames used"] * (len(frames) > 1)


def _lines(compared: Sequence[HasResult]) -> list[Line]:
    """Lay the table out."""
    scores = [method_scores(one.result) for one in compared]
    lines = [
        Line("Method", "", [title_of(one.run.method) for one in compared], "When to use it is told below the table."),
        Line(
            "Claimed error",
            "bound sigmas",
            [fixed(score.claimed, 3) for score in scores],
            "Claimed σ over the Cramér-Rao bound, geometric mean over the free parameters: one is all that the stars hold.",
        ),
        Line(
            "Cost",
            "ms / frame",
            [number(score.ms_per_frame, 3) for score in scores],
            "Processor time of the method alone, matching left out, measured once: below a factor of two it ranks nothing. "
            "A replay has none; paired rounds of every method are in the report of boresight reproduce wu.",
        ),
        Line(
            "Converged after",
            "",
            [_settled(one, score) for one, score in zip(compared, scores, strict=True)],
            f"All free parameters stay within {SETTLED_SIGMAS:.0f} final σ of their end from there on.",
        ),
        Line(
            "Condition number",
            "1",
            [number(score.condition, 3) for score in scores],
            "Of the whole set's scaled Jacobian at the end: alike where the methods agree.",
        ),
        Line(
            "χ² / dof",
            "1",
            [_verdict(score.chi2_per_dof, score.consistent, 3) for score in scores],
            "Of all arcs at the end, whatever was measured, with the verdict of its 95 % bounds.",
        ),
    ]
    return [*lines[:2], *_against_truth(scores), *lines[2:]]


def _against_truth(scores: Sequence[MethodScores]) -> list[Line]:
    """Lay out what only a simulated sensor can tell."""
    if all(score.honesty is None for score in scores):
        return []
    return [
        Line(
            "True error",
            "bound sigmas",
            [fixed(score.true_error, 3) for score in scores],
            "Root mean square over the free parameters, against the simulated truth: about one for an efficient method.",
        ),
        Line(
            "NEES / n",
            "1",
            [
                _verdict(score.honesty.mean, score.honesty.consistent, 3) if score.honesty else MISSING
                for score in scores
            ],
            "True error squared over the claimed covariance: one on average where the claim is honest, with its verdict.",
        ),
    ]


def _settled(one: HasResult, score: MethodScores) -> str:
    """Write how long a method took to its end."""
    if is_sequential(one.run.method):
        return MISSING if score.settled_frames is None else _many(score.settled_frames, "frame")
    return MISSING if score.settled_iterations is None else _many(score.settled_iterations, "iteration")


def _many(number_of: int, what: str) -> str:
    """Write so many of something."""
    return f"{count(number_of)} {what}{'' if number_of == 1 else 's'}"


def _verdict(value: float | None, consistent: bool | None, digits: int) -> str:
    """Write a statistic with what its bounds say of it."""
    said = {True: " consistent", False: " not consistent", None: ""}[consistent]
    return MISSING if value is None else f"{number(value, digits)}{said}"
