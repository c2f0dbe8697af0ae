"""What a calibration's numbers say about its own trustworthiness: one mark a question, the worst of which is the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.calibration.result import trend_entry
from boresight.estimation.filters import FILTERS
from boresight.estimation.statistics.observability import WEAK
from boresight.verdicts.numbers import count, number, percent, urad

LEVELS = ("off", "standby", "normal", "caution", "serious", "critical")  # of the Astro UX status system, worst last
LEVEL_OF_STATUS = {
    "running": "standby",
    "converged": "normal",
    "max_iterations": "caution",
    "rank_deficient": "serious",
    "diverged": "critical",
    "too_few_stars": "critical",
}
WORD_OF_LEVEL = {
    "serious": "converged, but no better",
    "caution": "converged, with reservations",
}  # of a fit that converged
WHY = {
    "running": "The run is not over: everything below is provisional.",
    "max_iterations": "The fit stopped before it came to rest: raise the number of iterations, or start closer.",
    "rank_deficient": "The data do not determine every free parameter: free fewer, or add frames with other stars.",
    "diverged": "The fit diverged: do not use these numbers.",
    "too_few_stars": "No exposure has enough stars: nothing was estimated.",
}
UNSEEN_TYPICAL_SIGMAS = 1.0  # a direction known no better than unit-to-unit spread was not calibrated
AT_THE_BOUND = (0.97, 1.15)  # claimed sigma over bound: below it is too good to be true, above it data are wasted
CAUSES = ("radius", "magnitude", "temperature", "time")
NOT_YET = "Trust is examined when the run ends; it is not there yet."
NEVER = "This result was made without an examination of trust: clone its run and start it again to have one."
NO_REASON = "This part of the examination could not be made for this run."


@dataclass(frozen=True)
class VerdictMark:
    """One answer on the verdict strip."""

    question: str
    level: str
    word: str
    value: str
    detail: str
    reason: str = ""


@dataclass(frozen=True)
class RunVerdict:
    """The worst of the marks."""

    level: str
    word: str
    reasons: tuple[str, ...]


def _unknown(question: str, detail: str) -> VerdictMark:
    return VerdictMark(question, "off", "NO DATA", "–", detail)


def _not_yet(result: Mapping[str, Any], never: str) -> str:
    """Say that the answer comes with the end of the run, or why there is none."""
    return "Judged when the run ends." if result.get("status") == "running" else never


def _fit(result: Mapping[str, Any]) -> VerdictMark:
    status = str(result.get("status", "unknown"))
    if status == "running":
        return VerdictMark("Fit", LEVEL_OF_STATUS[status], status, *_so_far(result), WHY[status])
    used = (
        f"{count(result.get('frames'))} frames, {count(result.get('stars'))} stars, {count(result.get('pairs'))} pairs"
    )
    steps = result.get("iterations")
    level, reason = LEVEL_OF_STATUS.get(status, "serious"), WHY.get(status, f"The status is {status}.")
    value = f"{count(steps)} iteration{'s' * (steps != 1)}" if steps else ""
    return VerdictMark("Fit", level, status.replace("_", " "), value, used, "" if level == "normal" else reason)


def _so_far(result: Mapping[str, Any]) -> tuple[str, str]:
    """Say as of which frame or iteration a run on its way is told, and how much of its set it has taken in."""
    done, frames = result.get("frames_done"), count(result.get("frames"))
    newest = ((result.get("history") or {}).get("frame") or [None])[-1]
    steps = result.get("iterations")
    value = f"as of frame {newest}" if newest is not None else f"as of iteration {steps}" if steps else ""
    return value, f"{frames} frames in all" if done is None else f"{count(done)} of {frames} frames so far"


def _chi_square(result: Mapping[str, Any]) -> VerdictMark:
    question, chi2, per_dof = "χ² per degree of freedom", result.get("chi2") or {}, result.get("chi2_per_dof")
    if per_dof is None or chi2.get("consistent") is None:
        return _unknown(question, _not_yet(result, "No chi-square was computed."))
    detail = f"95 % bounds {_bounds(chi2)}, {count(chi2.get('dof'))} degrees of freedom"
    if chi2["consistent"]:
        return VerdictMark(question, "normal", "consistent", number(per_dof), detail)
    word = "noise above model" if per_dof > 1 else "noise below model"
    reason = f"{question} is {number(per_dof, 3)}: the noise is not what was assumed."
    return VerdictMark(question, "caution", word, number(per_dof), detail, reason)


def _bounds(test: Mapping[str, Any]) -> str:
    return f"{number(test.get('lower'))} to {number(test.get('upper'))}"


def _nis(result: Mapping[str, Any]) -> VerdictMark:
    question, nis = "Innovations (NIS)", result.get("nis") or {}
    if result.get("method") not in FILTERS:
        return VerdictMark(question, "off", "not applicable", "", "A batch has no innovations; a filter has.")
    if nis.get("consistent") is None:
        return _unknown(question, "No innovations yet.")
    value, detail = number(nis.get("mean")), f"95 % bounds {_bounds(nis)}, a degree of freedom"
    if nis["consistent"]:
        return VerdictMark(question, "normal", "consistent", value, detail)
    word = "over-confident" if (nis.get("mean") or 0.0) > (nis.get("upper") or 0.0) else "pessimistic"
    reason = "The innovations are outside their 95 % bounds: the sigmas of this filter are not honest."
    return VerdictMark(question, "caution", word, value, detail, reason)


def _weakest(result: Mapping[str, Any]) -> VerdictMark:
    question, seen = "Weakest direction", result.get("observability") or {}
    spread = [sigma for sigma in seen.get("sigma_of_direction") or () if sigma is not None]
    sentence = str((seen.get("weakest") or {}).get("sentence") or "One direction was not seen at all.")
    if not seen.get("singular_values"):
        return _unknown(question, _not_yet(result, "Observability was not computed."))
    worst = max(spread, default=0.0)
    if len(spread) < len(seen["singular_values"]):
        value = f"condition {number(seen.get('condition_number'), 3)}"
        return VerdictMark(question, "caution", "not seen", value, sentence, sentence)
    if worst > UNSEEN_TYPICAL_SIGMAS:
        return VerdictMark(question, "caution", "not seen", f"{number(worst, 2)} typical σ", sentence, sentence)
    return VerdictMark(question, "normal", "seen", f"{number(worst, 2)} typical σ", sentence)


def _validation(result: Mapping[str, Any]) -> VerdictMark:
    question, validation = "Validation RMS", result.get("validation") or {}
    rms = validation.get("rms_arc_rad") or {}
    before, after = rms.get("initial"), rms.get("final")
    if before is None or after is None:
        return _unknown(question, _not_yet(result, "Nothing outside the fitted frames was checked."))
    available = (validation.get("availability") or {}).get("final")
    detail = f"{count(validation.get('frames'))} held-out frames, {percent(available)} available"
    sigma = sigma_of_rms(after, validation.get("common_pairs"))
    detail += "; σ not kept" if sigma is None else f"; the new RMS is known to ± {urad(3 * sigma, 2)} µrad (3σ)"
    value = f"{urad(before)} → {urad(after)} µrad"
    if after < before:
        return VerdictMark(question, "normal", "better", value, detail)
    reason = f"On the validation set the error went from {urad(before)} to {urad(after)} µrad."
    return VerdictMark(question, "serious", "worse" if after > before else "no better", value, detail, reason)


def make_verdict_marks(result: Mapping[str, Any]) -> list[VerdictMark]:
    """Answer the five questions of the verdict strip from a calibration JSON."""
    return [question(result) for question in (_fit, _chi_square, _nis, _weakest, _validation)]


def make_verdict(result: Mapping[str, Any]) -> RunVerdict:
    """Judge a result by the worst of its marks and its examination's; one whose fit did not converge by that alone."""
    answers = [*make_verdict_marks(result), *trust_marks(result)]
    fit = answers[0]
    if fit.reason:
        return RunVerdict(fit.level, fit.word, (fit.reason,))
    level = max((mark.level for mark in answers), key=LEVELS.index)
    against = tuple(mark.reason for mark in answers if mark.reason)
    agreement = "The statistics agree with the noise that was assumed."
    return RunVerdict(level, WORD_OF_LEVEL.get(level, "converged and consistent"), against or (agreement,))


def trust_marks(result: Mapping[str, Any]) -> list[VerdictMark]:
    """Answer the questions of the examination; none where a result has no examination."""
    if not result.get("trust"):
        return []
    return [question(result) for question in (_halves, _innovations, _whiteness, _causes, _efficiency, _needed, _stars)]


def trust_level(result: Mapping[str, Any]) -> str:
    """Return the worst level of the examination, `off` where there is none."""
    return max((mark.level for mark in trust_marks(result)), key=LEVELS.index, default="off")


def trust_doubts(result: Mapping[str, Any]) -> list[str]:
    """List what the examination holds against the result, a sentence each."""
    return [mark.reason for mark in trust_marks(result) if mark.reason]


def prospects(result: Mapping[str, Any]) -> list[str]:
    """Say what more data would buy, which speaks neither for nor against the result."""
    sentence = (read_part(result, "more_data") or {}).get("sentence")
    return [str(sentence)] if sentence else []


def _not_made(result: Mapping[str, Any], question: str, part: str) -> VerdictMark:
    return VerdictMark(question, "off", "NO DATA", "–", why_absent(result, part))


def _examined(question: str, words: tuple[str, str], sound: bool, value: str, sentence: str) -> VerdictMark:
    """Make a mark: the first word where all is well, the second, with the sentence as doubt, where it is not."""
    if sound:
        return VerdictMark(question, "normal", words[0], value, sentence)
    return VerdictMark(question, "caution", words[1], value, sentence, sentence or f"{question}: {words[1]}.")


def _halves(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Two halves", read_part(result, "two_halves")
    chi2: Mapping[str, Any] = (part or {}).get("chi2") or {}
    if not part or chi2.get("consistent") is None:
        return _not_made(result, question, "two_halves")
    value = f"χ² {number(chi2.get('value'), 3)} for {count(chi2.get('dof'))}"
    sound = chi2["consistent"] or not chi2["value"] > chi2["upper"]  # halves more alike than expected are no doubt
    return _examined(question, ("agree", "differ"), sound, value, str(part.get("sentence") or ""))


def _innovations(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Innovations over time", read_part(result, "nis_over_time")
    if not part or part.get("consistent") is None:
        return _not_made(result, question, "nis_over_time")
    value = f"{percent(part.get('outside_share'))} outside"
    return _examined(question, ("as expected", "uneven"), part["consistent"], value, str(part.get("sentence") or ""))


def _whiteness(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Whiteness", read_part(result, "whiteness")
    if not part or part.get("white") is None:
        return _not_made(result, question, "whiteness")
    value = f"p {number((part.get('ljung_box') or {}).get('p'), 2)}"
    return _examined(question, ("white", "not white"), part["white"], value, str(part.get("sentence") or ""))


def _efficiency(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Efficiency", read_part(result, "efficiency")
    ratio = (part or {}).get("overall_ratio")
    if not part or ratio is None:
        return _not_made(result, question, "efficiency")
    low, high = AT_THE_BOUND
    word = "too good to be true" if ratio < low else "wasteful"
    value = f"{number(ratio, 3)} times the bound"
    return _examined(question, ("at the bound", word), low <= ratio <= high, value, str(part.get("sentence") or ""))


def _causes(result: Mapping[str, Any]) -> VerdictMark:
    """Hold the residual against its causes: the sentences of those that explain it."""
    question, part = "Residual against causes", read_part(result, "residual_against")
    judged = [(name, part[name]) for name in CAUSES if (part or {}).get(name) and part[name].get("even") is not None]
    if not judged:
        return _not_made(result, question, "residual_against")
    uneven = [(name, bins) for name, bins in judged if not bins["even"]]
    told = " ".join(str(bins.get("sentence") or "") for _, bins in uneven)
    value = ", ".join(name for name, _ in uneven or judged)
    return _examined(
        question, ("even", "uneven"), not uneven, value, told or "The radial residual depends on none of them."
    )


def _needed(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Parameters", read_part(result, "drop_one")
    if not part:
        return _not_made(result, question, "drop_one")
    needed = sum(bool(row.get("needed")) for row in part)
    sentence = str((result.get("trust") or {}).get("drop_one_sentence") or "")
    return _examined(question, ("all needed", "some spare"), needed == len(part), f"{needed} of {len(part)}", sentence)


def _stars(result: Mapping[str, Any]) -> VerdictMark:
    question, part = "Stars", read_part(result, "stars")
    if not part:
        return _not_made(result, question, "stars")
    trust: Mapping[str, Any] = result["trust"]
    suspects: Sequence[Any] = trust.get("suspects") or ()
    value = f"{count(len(suspects))} of {count(trust.get('stars_in_all') or len(part))}"
    sentence = str(trust.get("stars_sentence") or "Look at the suspects before the next run.")
    return _examined(question, ("none suspect", "suspects"), not suspects, value, sentence)


def read_part(result: Mapping[str, Any], name: str) -> Any:
    """Read one part of `trust`; None where it is not there, or is empty."""
    return (result.get("trust") or {}).get(name) or None


def why_absent(result: Mapping[str, Any], name: str) -> str:
    """Say in a sentence why a part is not there."""
    trust = result.get("trust")
    if not trust:
        return NEVER if result.get("status") not in {None, "running"} else NOT_YET
    return str((trust.get("unavailable") or {}).get(name) or NO_REASON)


def sigma_of_rms(rms_rad: float | None, arcs: float | None) -> float | None:
    """Return one sigma of an RMS over so many arcs, in its unit."""
    return None if rms_rad is None or not arcs else float(rms_rad / np.sqrt(2 * arcs))


def summarise_run(result: Mapping[str, Any]) -> dict[str, Any]:
    """Pick the figures for lists from a calibration JSON; what it does not have, or is no number there, is None."""
    judged = make_verdict(result)
    advice = [*(result.get("advice") or ()), *(judged.reasons if judged.level != "normal" else ())]
    found = {
        "status": result.get("status"),
        "level": judged.level,
        "advice": advice[0] if advice else None,
        "chi2_consistent": _within(result, "chi2", "consistent"),
        "weak_directions": _weak_directions(result),
        "rms_initial_arc_rad": _within(result, "rms_arc_rad", "initial"),
        "rms_final_arc_rad": _within(result, "rms_arc_rad", "final"),
        "chi2_per_dof": result.get("chi2_per_dof"),
        "iterations": result.get("iterations"),
        "frames": result.get("frames"),
        "stars": result.get("stars"),
        "weakest": _within(result, "observability", "weakest", "sentence"),
        "tail_rms_rad": _last(_within(result, "history", "tail_rms_rad")),
        "availability": _within(result, "validation", "availability", "final"),
        "trend": to_plain(trend_entry(parse_calibration(result))),
        "validation_rms_initial_arc_rad": _within(result, "validation", "rms_arc_rad", "initial"),
        "validation_rms_final_arc_rad": _within(result, "validation", "rms_arc_rad", "final"),
    }
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> Any:
    """Return a value as JSON would give it back: no arrays, no NaN."""
    if isinstance(value, Mapping):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _last(values: Any) -> Any:
    """Return the last of a series; None where there is none."""
    return values[-1] if isinstance(values, list) and values else None


def _weak_directions(result: Mapping[str, Any]) -> int | None:
    """Count the directions that the data hardly determine, or not at all; None where they were not looked for."""
    spread = _within(result, "observability", "sigma_of_direction")
    return None if spread is None else sum(sigma is None or sigma > WEAK for sigma in spread)


def _within(document: Mapping[str, Any], *path: str) -> Any:
    """Follow keys down; None where the path ends early."""
    place: Any = document
    for key in path:
        place = place.get(key) if isinstance(place, Mapping) else None
    return place
