"""The examination in a line: each part of `trust` as a mark of the verdict strip, and what more data would buy as advice.

A part that could not be made is NO DATA with its reason, never a pass.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from boresight.figures.chart import Result
from boresight.figures.evidence import LEVELS, Mark
from boresight.figures.numbers import count, number, percent
from boresight.figures.trust_parts import part_of, why_absent

AT_THE_BOUND = (0.95, 1.15)  # claimed sigma over bound: below it is too good to be true, above it data are wasted
CLEAR_SIGMA = 3.0


def trust_marks(result: Result) -> list[Mark]:
    """Answer the questions of the examination; none where a result has no examination."""
    if not result.get("trust"):
        return []
    return [question(result) for question in (_halves, _innovations, _whiteness, _efficiency, _needed, _stars)]


def trust_level(result: Result) -> str:
    """Return the worst level of the examination, `off` where there is none."""
    return max((mark.level for mark in trust_marks(result)), key=LEVELS.index, default="off")


def trust_doubts(result: Result) -> list[str]:
    """List what the examination holds against the result, a sentence each."""
    return [mark.reason for mark in trust_marks(result) if mark.reason]


def prospects(result: Result) -> list[str]:
    """Say what more data would buy, and whatever else speaks neither for nor against the result."""
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
    return _mark(question, ("agree", "differ"), chi2["consistent"], value, str(part.get("sentence") or ""))


def _innovations(result: Result) -> Mark:
    """Hold the share of frames outside their bounds against what chance puts there, to three of its sigmas."""
    question, part = "Innovations over time", part_of(result, "nis_over_time")
    share, expected = ((part or {}).get(key) for key in ("outside_share", "expected_share"))
    if not part or share is None or not expected:
        return _unknown(result, question, "nis_over_time")
    reach = CLEAR_SIGMA * math.sqrt(expected * (1 - expected) / max(len(part["frame"]), 1))
    word = "too many outside" if share > expected else "too few outside"
    value = f"{percent(share)} of {percent(expected)}"
    return _mark(
        question, ("as expected", word), abs(share - expected) <= reach, value, str(part.get("sentence") or "")
    )


def _whiteness(result: Result) -> Mark:
    question, part = "Whiteness", part_of(result, "whiteness")
    if not part or part.get("white") is None:
        return _unknown(result, question, "whiteness")
    value = f"p {number((part.get('ljung_box') or {}).get('p'), 2)}"
    return _mark(question, ("white", "not white"), part["white"], value, str(part.get("sentence") or ""))


def _efficiency(result: Result) -> Mark:
    question, part = "Efficiency", part_of(result, "efficiency")
    ratios = [ratio for ratio in ((part or {}).get("ratio") or {}).values() if ratio is not None]
    if not part or not ratios:
        return _unknown(result, question, "efficiency")
    low, high = min(ratios), max(ratios)
    word = "too good to be true" if low < AT_THE_BOUND[0] else "wasteful"
    value = f"{number(low, 3)} to {number(high, 3)}"
    sound = low >= AT_THE_BOUND[0] and high <= AT_THE_BOUND[1]
    return _mark(question, ("at the bound", word), sound, value, str(part.get("sentence") or ""))


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
    in_all = trust.get("stars_in_all") or len(part)
    said = f"{count(len(suspects))} of {count(in_all)} stars"
    stand = "stands" if len(suspects) == 1 else "stand"
    sentence = f"{said} {stand} clear of their own noise: look at them before the next run."
    words = ("none suspect", "suspects")
    return _mark(
        question, words, not suspects, said, sentence if suspects else "No star stands clear of its own noise."
    )
