"""What a calibration's numbers say about its own trustworthiness: one mark a question, each with a level and a word.

No mark is weighed against another and no score is made: the strip as a whole is as good as its worst mark, which is the
verdict; the examination of trust (`trust_marks`) counts alike. Where a question cannot be answered the mark says NO DATA;
it never passes for an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.estimation.filters import FILTERS
from boresight.figures.mark import LEVELS, Mark
from boresight.figures.numbers import count, number, percent, urad
from boresight.figures.rms_tail import sigma_of_rms
from boresight.figures.trust_marks import trust_marks

__all__ = ["LEVELS", "LEVEL_OF_STATUS", "WORD_OF_LEVEL", "Mark", "Verdict", "marks", "verdict"]

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


@dataclass(frozen=True)
class Verdict:
    """The worst of the marks.

    Parameters
    ----------
    level, word
        As a mark's.
    reasons
        What speaks against trusting the result, a sentence each.
    """

    level: str
    word: str
    reasons: tuple[str, ...]


def _unknown(question: str, detail: str) -> Mark:
    return Mark(question, "off", "NO DATA", "–", detail)


def _not_yet(result: Mapping[str, Any], never: str) -> str:
    """Say that the answer comes with the end of the run, or why there is none."""
    return "Judged when the run ends." if result.get("status") == "running" else never


def _fit(result: Mapping[str, Any]) -> Mark:
    status = str(result.get("status", "unknown"))
    if status == "running":
        return Mark("Fit", LEVEL_OF_STATUS[status], status, *_so_far(result), WHY[status])
    used = (
        f"{count(result.get('frames'))} frames, {count(result.get('stars'))} stars, {count(result.get('pairs'))} pairs"
    )
    steps = result.get("iterations")
    level, reason = LEVEL_OF_STATUS.get(status, "serious"), WHY.get(status, f"The status is {status}.")
    value = f"{count(steps)} iteration{'s' * (steps != 1)}" if steps else ""
    return Mark("Fit", level, status.replace("_", " "), value, used, "" if level == "normal" else reason)


def _so_far(result: Mapping[str, Any]) -> tuple[str, str]:
    """Say as of which frame or iteration a run on its way is told, and how much of its set it has taken in."""
    done, frames = result.get("frames_done"), count(result.get("frames"))
    newest = ((result.get("history") or {}).get("frame") or [None])[-1]
    steps = result.get("iterations")
    value = f"as of frame {newest}" if newest is not None else f"as of iteration {steps}" if steps else ""
    return value, f"{frames} frames in all" if done is None else f"{count(done)} of {frames} frames so far"


def _chi_square(result: Mapping[str, Any]) -> Mark:
    question, chi2, per_dof = "χ² per degree of freedom", result.get("chi2") or {}, result.get("chi2_per_dof")
    if per_dof is None or chi2.get("consistent") is None:
        return _unknown(question, _not_yet(result, "No chi-square was computed."))
    detail = f"95 % bounds {_bounds(chi2)}, {count(chi2.get('dof'))} degrees of freedom"
    if chi2["consistent"]:
        return Mark(question, "normal", "consistent", number(per_dof), detail)
    word = "noise above model" if per_dof > 1 else "noise below model"
    reason = f"{question} is {number(per_dof, 3)}: the noise is not what was assumed."
    return Mark(question, "caution", word, number(per_dof), detail, reason)


def _bounds(test: Mapping[str, Any]) -> str:
    return f"{number(test.get('lower'))} to {number(test.get('upper'))}"


def _nis(result: Mapping[str, Any]) -> Mark:
    question, nis = "Innovations (NIS)", result.get("nis") or {}
    if result.get("method") not in FILTERS:
        return Mark(question, "off", "not applicable", "", "A batch has no innovations; a filter has.")
    if nis.get("consistent") is None:
        return _unknown(question, "No innovations yet.")
    value, detail = number(nis.get("mean")), f"95 % bounds {_bounds(nis)}, a degree of freedom"
    if nis["consistent"]:
        return Mark(question, "normal", "consistent", value, detail)
    word = "over-confident" if (nis.get("mean") or 0.0) > (nis.get("upper") or 0.0) else "pessimistic"
    reason = "The innovations are outside their 95 % bounds: the sigmas of this filter are not honest."
    return Mark(question, "caution", word, value, detail, reason)


def _weakest(result: Mapping[str, Any]) -> Mark:
    question, seen = "Weakest direction", result.get("observability") or {}
    spread = [sigma for sigma in seen.get("sigma_of_direction") or () if sigma is not None]
    sentence = str((seen.get("weakest") or {}).get("sentence") or "One direction was not seen at all.")
    if not seen.get("singular_values"):
        return _unknown(question, _not_yet(result, "Observability was not computed."))
    worst = max(spread, default=0.0)
    if len(spread) < len(seen["singular_values"]):
        value = f"condition {number(seen.get('condition_number'), 3)}"
        return Mark(question, "caution", "not seen", value, sentence, sentence)
    if worst > UNSEEN_TYPICAL_SIGMAS:
        return Mark(question, "caution", "not seen", f"{number(worst, 2)} typical σ", sentence, sentence)
    return Mark(question, "normal", "seen", f"{number(worst, 2)} typical σ", sentence)


def _validation(result: Mapping[str, Any]) -> Mark:
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
        return Mark(question, "normal", "better", value, detail)
    reason = f"On the validation set the error went from {urad(before)} to {urad(after)} µrad."
    return Mark(question, "serious", "worse" if after > before else "no better", value, detail, reason)


def marks(result: Mapping[str, Any]) -> list[Mark]:
    """Answer the five questions of the verdict strip from a calibration JSON."""
    return [question(result) for question in (_fit, _chi_square, _nis, _weakest, _validation)]


def verdict(result: Mapping[str, Any]) -> Verdict:
    """Judge a result by the worst of its marks and its examination's; one whose fit did not converge by that alone."""
    answers = [*marks(result), *trust_marks(result)]
    fit = answers[0]
    if fit.reason:
        return Verdict(fit.level, fit.word, (fit.reason,))
    level = max((mark.level for mark in answers), key=LEVELS.index)
    against = tuple(mark.reason for mark in answers if mark.reason)
    agreement = "The statistics agree with the noise that was assumed."
    return Verdict(level, WORD_OF_LEVEL.get(level, "converged and consistent"), against or (agreement,))
