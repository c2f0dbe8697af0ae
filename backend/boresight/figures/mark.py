"""One answer of the verdict strip: a question, a level and a word, a number, and what speaks against trusting the result."""

from __future__ import annotations

from dataclasses import dataclass

LEVELS = ("off", "standby", "normal", "caution", "serious", "critical")  # of the Astro UX status system, worst last


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
    reason
        What speaks against trusting the result, a sentence; empty where nothing does.
    """

    question: str
    level: str
    word: str
    value: str
    detail: str
    reason: str = ""
