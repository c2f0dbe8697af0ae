"""What a run's result answers at a glance: one line over all parts, and the four views that a reviewer asks for first.

Each view is a question with a sentence, which is also the title of the large figure, so that page, figure and request say
the same. A sentence is made of numbers of the result alone and never of another sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from boresight.calibration.calibration import Calibration, Observability, RadialDifference
from boresight.estimation.statistics.observability import NAMED
from boresight.verdicts.history import History, interval_of_fit, read_history, settled_step, summarise_tail
from boresight.verdicts.numbers import count, number, quantity, signed, urad, urad_between
from boresight.verdicts.verdict import (
    LEVELS,
    count_weak,
    describe_rms,
    list_rms,
    make_advice,
    make_verdict,
    make_verdict_marks,
    trust_marks,
)


@dataclass(frozen=True)
class ViewAnswer:
    """What a view says: how it stands, and one sentence."""

    level: str
    sentence: str


@dataclass(frozen=True)
class RunView:
    """One of the four views: the figure it draws, the part of the run's page that has the large one, and its answer."""

    figure: str
    part: str
    title: str
    answer: ViewAnswer


@dataclass(frozen=True)
class Headline:
    """The verdict in a line: its level and word, the numbers, each RMS with its interval, and its warnings, worst first."""

    level: str
    word: str
    numbers: str
    at_length: str
    warnings: tuple[str, ...]


def make_headline(result: Calibration) -> Headline:
    """Say in a line what a result is worth."""
    judged = make_verdict(result)
    doubts = [mark for mark in (*make_verdict_marks(result), *trust_marks(result)) if mark.reason]
    ordered = sorted(doubts, key=lambda mark: -LEVELS.index(mark.level))
    reasons = [make_advice(mark, result) for mark in ordered] if judged.level != "normal" else []
    rms, unseen = result.rms_arc_rad, result.validation.rms_arc_rad if result.validation else None
    told, at_length = [], []
    if rms.initial is not None and rms.final is not None:
        both = list_rms(result.evaluation, rms, result.pairs)
        told.append(f"RMS {urad(rms.initial, 3)} → {both[1]} µrad")
        at_length.append(f"RMS {' → '.join(both)} µrad")
    if result.validation and unseen and unseen.initial is not None and unseen.final is not None:
        both = list_rms(result.validation, unseen, result.validation.common_pairs)
        told.append(f"validation {urad(unseen.initial, 3)} → {both[1]} µrad")
        at_length.append(f"validation {' → '.join(both)} µrad")
    if told and interval_of_fit(result, rms.final) is not None:
        told[-1] += " (95 %)"
    seen = result.observability
    if seen and seen.singular_values:
        told.append("no weak direction" if not count_weak(seen) else describe_weak(seen))
    return Headline(
        judged.level,
        judged.word,
        "; ".join(told),
        "; ".join(at_length),
        tuple(dict.fromkeys([*reasons, *result.advice])),
    )


def make_four_views(result: Calibration | None) -> list[RunView]:
    """Answer the four questions that decide about a result; what it does not have says so."""
    found = result or Calibration(status="running")
    return [RunView(figure, part, title, answer(found)) for figure, part, title, answer in _VIEWS]


def describe_weak(seen: Observability) -> str:
    """Say how many of the directions are not seen, such as `3 of 8 directions are not seen`."""
    weak, whole = count_weak(seen), len(seen.singular_values)
    if not weak:
        return f"{count(whole)} of {count(whole)} directions are determined"
    return f"{count(weak)} of {count(whole)} directions {'is' if weak == 1 else 'are'} weak"


def answer_observability(result: Calibration) -> ViewAnswer:
    """Say how many directions the data see, and how well the weakest is known."""
    seen = result.observability
    if seen is None or not seen.singular_values:
        return _nothing(result, "Observability was not computed.")
    level = "caution" if count_weak(seen) else "normal"
    return ViewAnswer(level, f"{describe_weak(seen)}; {_weakest(seen, result)}.")


def _weakest(seen: Observability, result: Calibration) -> str:
    shares = {name: share for name, share in seen.weakest.direction.items() if share is not None}
    ordered = sorted(shares, key=lambda name: -abs(shares[name]))
    named = [quantity(name, result).symbol for name in ordered if abs(shares[name]) >= NAMED]
    spread = seen.sigma_of_direction[-1] if seen.sigma_of_direction else None
    known = "is not determined" if spread is None else f"is known to {number(spread, 2)} typical σ"
    return f"the weakest{' (' + ', '.join(named) + ')' if named else ''} {known}"


def answer_convergence(result: Calibration) -> ViewAnswer:
    """Say where the estimate settled, and whether it ended inside the bands that it drew on its way."""
    history = read_history(result)
    if history is None:
        return _nothing(result, "No history was stored.", "Drawn as the run goes on.")
    if result.status == "running":
        return ViewAnswer("standby", f"Running: {history.axis} {count(history.x[-1])}.")
    first, free = settled_step(result), len(history.free)
    if first is None:
        return ViewAnswer("caution", f"Not converged by the end, {history.axis} {count(history.x[-1])}.")
    whole = "The parameter" if free == 1 else f"All {count(free)} parameters"
    settled = f"{whole} converged by {history.axis} {count(history.x[first])}"
    if history.axis == "iteration":
        return ViewAnswer("normal", f"{settled} of {count(history.x[-1])}.")
    left = count_left_bands(history)
    if not left:
        each = "its" if free == 1 else "each"
        return ViewAnswer("normal", f"{settled}; {each} final value is inside its earlier ±3σ bands.")
    outside = f"{count(left)} of {count(free)} final values {'is' if left == 1 else 'are'} outside"
    return ViewAnswer("caution", f"{settled}; {outside} a ±3σ band of the second half of the run.")


def count_left_bands(history: History) -> int:
    """Count the free parameters whose end lies outside a 3-sigma band that they had in the second half of the run."""
    free = [history.names.index(name) for name in history.free]
    value, sigma = (rows[len(history.x) // 2 :, free] for rows in (history.value, history.sigma))
    away = np.abs(value - value[-1]) > 3 * sigma
    return int(away.any(axis=0).sum())


def answer_rms(result: Calibration) -> ViewAnswer:
    """Say whether tail and aggregate meet, and how far the error fell."""
    rms, tail = result.rms_arc_rad, summarise_tail(result)
    if tail is not None and tail.tail_rad is not None and tail.aggregate_rad is not None:
        told = [urad_between(one, interval_of_fit(result, one)) for one in (tail.tail_rad, tail.aggregate_rad)]
        both = f"tail {told[0]}, aggregate {told[1]} µrad, 95 % in brackets"
        if result.status == "running":
            return ViewAnswer("standby", f"So far: {both}.")
        meet = abs(tail.tail_rad - tail.aggregate_rad) <= 3 * (tail.sigma_rad or 0.0)
        words = "Tail and aggregate agree" if meet else "Tail and aggregate differ"
        return ViewAnswer("normal" if meet else "caution", f"{words}: {both}.")
    if rms.initial is None or rms.final is None:
        return _nothing(result, "No RMS arc error was computed.", "Drawn as the run goes on.")
    level = "standby" if result.status == "running" else "normal" if rms.final < rms.initial else "caution"
    return ViewAnswer(level, f"{describe_rms(result.evaluation, rms, result.pairs)} µrad, 95 % in brackets.")


@dataclass(frozen=True)
class LargestChange:
    """The largest radial change where stars reach: px with its sigma (None where not known), and its radius."""

    change_px: float
    sigma_px: float | None
    radius_px: float


def find_largest_change(radial: RadialDifference) -> LargestChange | None:
    """Find the largest change at the radii where stars were; None where no change is known."""
    edge = np.inf if radial.data_radius_px is None else radial.data_radius_px
    radius, change = (np.array(values, dtype=np.float64) for values in (radial.radius_px, radial.difference_px))
    known = np.isfinite(change) & (radius <= edge) if change.shape == radius.shape else np.zeros(0, dtype=bool)
    if not known.any():
        return None
    worst = int(np.argmax(np.where(known, np.abs(change), -1.0)))
    sigma = radial.sigma_px[worst] if worst < len(radial.sigma_px) else None
    known_sigma = sigma if sigma is not None and np.isfinite(sigma) else None
    return LargestChange(float(change[worst]), known_sigma, float(radius[worst]))


def describe_largest_change(radial: RadialDifference) -> str:
    """Say in a sentence how far the parameters move a star at most; nothing where that is not known."""
    found = find_largest_change(radial)
    if found is None:
        return ""
    spread = "" if found.sigma_px is None else f" ± {number(found.sigma_px, 2)}"
    level = "" if found.sigma_px is None else " (1σ)"
    return (
        f"At most {signed(found.change_px)}{spread} px{level} where stars reach, at radius {count(found.radius_px)} px"
    )


def answer_radial(result: Calibration) -> ViewAnswer:
    """Say how far the new parameters move a star along the radius."""
    said = describe_largest_change(result.radial) if result.radial and result.radial.radius_px else ""
    return ViewAnswer("normal", f"{said}.") if said else _nothing(result, "The radial difference was not computed.")


def _nothing(result: Calibration, never: str, later: str = "Computed when the run ends.") -> ViewAnswer:
    if result.status == "running":
        return ViewAnswer("standby", later)
    return ViewAnswer("off", never)


_VIEWS: tuple[tuple[str, str, str, Callable[[Calibration], ViewAnswer]], ...] = (
    ("convergence", "convergence", "Convergence, ±3σ", answer_convergence),
    ("rms", "convergence", "RMS arc error", answer_rms),
    ("radial", "distortion", "Radial difference, new − old", answer_radial),
    ("observability", "observability", "Observability", answer_observability),
)
