"""A calibration as text for a terminal: parameters with their sigmas, the quality of the fit, advice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boresight.calibration.calibration import (
        Calibration,
        Change,
        ChiSquareTest,
        Evaluation,
        InnovationTest,
        Matching,
    )


def aligned(rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """Lay rows out in columns two spaces apart, numbers to the right, the columns of `left` to the left."""
    table = [[str(cell) for cell in row] for row in rows]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    sides = [str.ljust if i in set(left) else str.rjust for i in range(len(widths))]
    return "\n".join(
        "  ".join(side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)).rstrip()
        for row in table
    )


def summary_lines(found: Calibration) -> Iterator[str]:
    """Write a calibration in lines."""
    from boresight.figures.tables import HEADINGS, printed_rows

    yield headline(found)
    if left_out := "; ".join(f"{item.count:,} {item.what}: {item.reason}" for item in found.left_out):
        yield f"left out: {left_out}"
    yield ""
    yield aligned([HEADINGS, *(row.cells for row in printed_rows(found))], left=(0, 1, 6))
    yield ""
    yield aligned([("verdict", verdict(found)), *_scores(found)], left=(0, 1))
    for sentence in found.advice:
        yield f"\n- {sentence}"


def headline(found: Calibration) -> str:
    """Return one line on what was calibrated, how, and from how much data."""
    words = [found.method, found.variant or "", found.status.replace("_", " ")]
    counts = f"{found.frames:,} frames, {found.exposures:,} exposures, {found.stars:,} stars, {found.pairs:,} pairs"
    return f"{found.sensor}: {', '.join(word for word in words if word)}; {counts}"


def verdict(found: Calibration) -> str:
    """Return the trustworthiness of the numbers in a word or two; the advice says why."""
    from boresight.verdicts.verdict import make_verdict

    return make_verdict(found).word


def _scores(found: Calibration) -> Iterator[tuple[str, str]]:
    yield "RMS arc error", _pair(found.rms_arc_rad)
    if found.chi2 is not None:
        yield "chi2 per degree of freedom", _test(found.chi2_per_dof, found.chi2)
    if found.nis is not None and found.method != "batch":
        yield "innovations (NIS)", _test(found.nis.mean, found.nis)
    if (seen := found.observability) is not None:
        number = seen.condition_number
        yield "condition number", "infinite" if number is None else f"{number:,.4g}"
        yield "weakest direction", seen.weakest.sentence
    if found.matching is not None:
        yield "matches", _matches(found.matching)
    for name, scores in (("calibration set", found.evaluation), ("validation set", found.validation)):
        if scores is not None:
            yield f"{name}, availability", _share(scores)
            yield f"{name}, RMS", _pair(scores.rms_arc_rad)
    if found.alignment is not None:
        yield "C_SD", found.alignment.sentence


def _matches(matching: Matching) -> str:
    """Return lines on the matching cycle: its counts, and whether it rests."""
    counts = f"{matching.given:,} given, {matching.kept:,} kept, {matching.removed:,} removed, {matching.added:,} added"
    cycles = len(matching.cycles)
    rest = "the matches rest" if matching.rested else "the matches do not rest yet"
    return f"{counts}; {rest}" + (f" after {cycles} {'cycle' if cycles == 1 else 'cycles'}" if cycles else "")


def _share(scores: Evaluation) -> str:
    """Return availability before and after with its interval, at the flight code's tolerance."""
    ends = scores.intervals.availability if scores.intervals else None
    sides = [
        _with_interval(scores.availability.initial, ends.initial if ends else ()),
        _with_interval(scores.availability.final, ends.final if ends else ()),
    ]
    tolerance = scores.flight_tolerance_rad
    within = "" if tolerance is None else f", arcs within {tolerance * 1e6:.0f} µrad"
    return f"{' -> '.join(sides)} of {scores.frames:,} frames{within}"


def _with_interval(share: float | None, interval: Sequence[float | None]) -> str:
    low, high = interval or (None, None)
    return ("-" if share is None else f"{share:.1%}") + (
        "" if low is None or high is None else f" ({low:.1%} to {high:.1%})"
    )


def _pair(rms: Change) -> str:
    before, after = ("-" if value is None else f"{value * 1e6:.2f}" for value in (rms.initial, rms.final))
    return f"{before} -> {after} µrad"


def _test(value: float | None, test: ChiSquareTest | InnovationTest) -> str:
    word = "consistent" if test.consistent else "NOT consistent"
    number, lower, upper = ("-" if one is None else f"{one:.4g}" for one in (value, test.lower, test.upper))
    return f"{number}, 95 % bounds {lower} to {upper}: {word}"
