"""The examination in a line: each part of `trust` as a mark of the verdict strip, and what more data would buy as advice.

A part that could not be made is NO DATA with its reason, never a pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from boresight.figures.chart import Result
from boresight.figures.mark import LEVELS, Mark
from boresight.figures.numbers import count, number, percent
from boresight.figures.trust_parts import part_of, why_absent

AT_THE_BOUND = (0.97, 1.15)  # claimed sigma over bound: below it is too good to be true, above it data are wasted
CAUSES = ("radius", "magnitude", "temperature", "time")


def trust_marks(result: Result) -> list[Mark]:
    """Answer the questions of the examination; none where a result has no examination."""
    if not result.get("trust"):
        return []
    return [question(result) for question in (_halves, _innovations, _whiteness, _causes, _efficiency, _needed, _stars)]


def trust_level(result: Result) -> str:
    """Return the worst level of the examination, `off` where there is none."""
    return max((mark.level for mark in trust_marks(result)), key=LEVELS.index, default="off")


def trust_doubts(result: Result) -> list[str]:
    """List what the examination holds against the result, a sentence each."""
    return [mark.reason for mark in trust_marks(result) if mark.reason]


def prospects(result: Result) -> list[str]:
    """Say what more data would buy, which speaks neither for nor against the result."""
    sentence = (part_of(result, "more_data") or {}).get("sentence")
    return [str(sentence)] if sentence else []


def _unknown(result: Result, question: str, part: str) -> Mark:
    return Mark(question, "off", "NO DATA", "–", why_absent(result, part))


def _mark(question: str, words: tuple[str, str], sound: bool, value: str, sentence: str) -> Mark:
    """Make a mark: the first word where all is well, the second, with the sentence as doubt, where it is not."""
    if sound:
        return Mark(question, "normal", words[0], value, sentence)
    return Mark(question, "caution", words[1], value, sentence, sentence or f"{question}: {words[1]}.")


def _halves(result: Result) -> Mark:
    question, part = "Two halves", part_of(result, "two_halves")
    chi2: Mapping[str, Any] = (part or {}).get("chi2") or {}
    if not part or chi2.get("consistent") is None:
        return _unknown(result, question, "two_halves")
    value = f"χ² {number(chi2.get('value'), 3)} for {count(chi2.get('dof'))}"
    sound = chi2["consistent"] or not chi2["value"] > chi2["upper"]  # halves more alike than expected are no doubt
    return _mark(question, ("agree", "differ"), sound, value, str(part.get("sentence") or ""))


def _innovations(result: Result) -> Mark:
    question, part = "Innovations over time", part_of(result, "nis_over_time")
    if not part or part.get("consistent") is None:
        return _unknown(result, question, "nis_over_time")
    value = f"{percent(part.get('outside_share'))} outside"
    return _mark(question, ("as expected", "uneven"), part["consistent"], value, str(part.get("sentence") or ""))


def _whiteness(result: Result) -> Mark:
    question, part = "Whiteness", part_of(result, "whiteness")
    if not part or part.get("white") is None:
        return _unknown(result, question, "whiteness")
    value = f"p {number((part.get('ljung_box') or {}).get('p'), 2)}"
    return _mark(question, ("white", "not white"), part["white"], value, str(part.get("sentence") or ""))


def _efficiency(result: Result) -> Mark:
    question, part = "Efficiency", part_of(result, "efficiency")
    ratio = (part or {}).get("overall_ratio")
    if not part or ratio is None:
        return _unknown(result, question, "efficiency")
    low, high = AT_THE_BOUND
    word = "too good to be true" if ratio < low else "wasteful"
    value = f"{number(ratio, 3)} times the bound"
    return _mark(question, ("at the bound", word), low <= ratio <= high, value, str(part.get("sentence") or ""))


def _causes(result: Result) -> Mark:
    """Hold the residual against its causes: the sentences of those that explain it."""
    question, part = "Residual against causes", part_of(result, "residual_against")
    judged = [(name, part[name]) for name in CAUSES if (part or {}).get(name) and part[name].get("even") is not None]
    if not judged:
        return _unknown(result, question, "residual_against")
    uneven = [(name, bins) for name, bins in judged if not bins["even"]]
    told = " ".join(str(bins.get("sentence") or "") for _, bins in uneven)
    value = ", ".join(name for name, _ in uneven or judged)
    return _mark(
        question, ("even", "uneven"), not uneven, value, told or "The radial residual depends on none of them."
    )


def _needed(result: Result) -> Mark:
    question, part = "Parameters", part_of(result, "drop_one")
    if not part:
        return _unknown(result, question, "drop_one")
    needed = sum(bool(row.get("needed")) for row in part)
    sentence = str((result.get("trust") or {}).get("drop_one_sentence") or "")
    return _mark(question, ("all needed", "some spare"), needed == len(part), f"{needed} of {len(part)}", sentence)


def _stars(result: Result) -> Mark:
    question, part = "Stars", part_of(result, "stars")
    if not part:
        return _unknown(result, question, "stars")
    trust: Mapping[str, Any] = result["trust"]
    suspects: Sequence[Any] = trust.get("suspects") or ()
    value = f"{count(len(suspects))} of {count(trust.get('stars_in_all') or len(part))}"
    sentence = str(trust.get("stars_sentence") or "Look at the suspects before the next run.")
    return _mark(question, ("none suspect", "suspects"), not suspects, value, sentence)
