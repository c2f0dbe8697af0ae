"""What a calibration's numbers say about its own trustworthiness: one mark a question, each with a level and a word.

No mark is weighed against another and no score is made: the strip as a whole is as good as its worst mark. Where a
question cannot be answered the mark says NO DATA; it never passes for an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.figures.numbers import count, number, percent, urad
from boresight.pages.methods import is_sequential
from boresight.pages.states import level_of

UNSEEN_TYPICAL_SIGMAS = 1.0  # a direction known no better than unit-to-unit spread was not calibrated


@dataclass(frozen=True)
class Mark:
    """One answer on the verdict strip.

    Parameters
    ----------
    question
        What is asked: two or three words.
    level, word
        Colour and shape, and the answer in a word.
    value, detail
        The number, and the limits it is held against or what it means.
    """

    question: str
    level: str
    word: str
    value: str
    detail: str


def _unknown(question: str, detail: str) -> Mark:
    return Mark(question, "off", "NO DATA", "–", detail)


def _not_yet(result: Mapping[str, Any], never: str) -> str:
    """Say that the answer comes with the end of the run, or why there is none."""
    return "Judged when the run ends." if result.get("status") == "running" else never


def _fit(result: Mapping[str, Any]) -> Mark:
    status = str(result.get("status", "unknown"))
    used = (
        f"{count(result.get('frames'))} frames, {count(result.get('stars'))} stars, {count(result.get('pairs'))} pairs"
    )
    steps = result.get("iterations")
    level = "standby" if status == "running" else level_of(status)
    return Mark("Fit", level, status.replace("_", " "), f"{count(steps)} iterations" if steps else "", used)


def _chi_square(result: Mapping[str, Any]) -> Mark:
    chi2, per_dof = result.get("chi2") or {}, result.get("chi2_per_dof")
    if per_dof is None or not chi2.get("dof"):
        return _unknown("χ² per degree of freedom", _not_yet(result, "No chi-square was computed."))
    consistent = bool(chi2.get("consistent"))
    detail = f"95 % bounds {_bounds(chi2)}, {count(chi2['dof'])} degrees of freedom"
    word = "consistent" if consistent else ("noise above model" if per_dof > 1 else "noise below model")
    return Mark("χ² per degree of freedom", "normal" if consistent else "caution", word, number(per_dof, 4), detail)


def _bounds(test: Mapping[str, Any]) -> str:
    return f"{number(test.get('lower'), 4)} to {number(test.get('upper'), 4)}"


def _nis(result: Mapping[str, Any]) -> Mark:
    nis = result.get("nis") or {}
    if not is_sequential(str(result.get("method"))):
        return Mark("Innovations (NIS)", "off", "not applicable", "", "A batch has no innovations; a filter has.")
    if nis.get("mean") is None:
        return _unknown("Innovations (NIS)", "No innovations yet.")
    consistent = bool(nis.get("consistent"))
    word = (
        "consistent" if consistent else ("over-confident" if nis["mean"] > (nis.get("upper") or 0) else "pessimistic")
    )
    detail = f"95 % bounds {_bounds(nis)}, a degree of freedom"
    return Mark("Innovations (NIS)", "normal" if consistent else "caution", word, number(nis["mean"], 4), detail)


def _weakest(result: Mapping[str, Any]) -> Mark:
    seen = result.get("observability") or {}
    weakest = seen.get("weakest") or {}
    if not weakest.get("sentence"):
        return _unknown("Weakest direction", _not_yet(result, "Observability was not computed."))
    spread = max((s for s in seen.get("sigma_of_direction") or [] if s is not None), default=None)
    unseen = spread is not None and spread > UNSEEN_TYPICAL_SIGMAS
    value = (
        f"{number(spread, 2)} typical σ"
        if spread is not None
        else f"condition {number(seen.get('condition_number'), 3)}"
    )
    return Mark(
        "Weakest direction", *(("caution", "not seen") if unseen else ("normal", "seen")), value, weakest["sentence"]
    )


def _validation(result: Mapping[str, Any]) -> Mark:
    validation = result.get("validation") or {}
    rms = validation.get("rms_arc_rad") or {}
    before, after = rms.get("initial"), rms.get("final")
    if before is None or after is None:
        return _unknown("Validation RMS", _not_yet(result, "Nothing outside the fitted frames was checked."))
    better = after <= before
    available = (validation.get("availability") or {}).get("final")
    detail = f"{count(validation.get('frames'))} held-out frames, {percent(available)} available"
    value = f"{urad(before)} → {urad(after)} µrad"
    return Mark("Validation RMS", "normal" if better else "serious", "better" if better else "worse", value, detail)


def marks(result: Mapping[str, Any]) -> list[Mark]:
    """Answer the five questions of the verdict strip from a calibration JSON."""
    return [question(result) for question in (_fit, _chi_square, _nis, _weakest, _validation)]
