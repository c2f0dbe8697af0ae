"""Passwords that are guessed early: common ones, ones made of common parts, and ones made of the person's own names.

zxcvbn estimates in how many guesses a password falls, from its lists (the 30,000 commonest passwords, names, words), from
keyboard patterns, dates, repeats and sequences; all of it offline. OWASP ASVS 4.0, 2.1.7, asks to refuse the commonest that
satisfy the length rule. The time that an estimate takes grows faster than the length, so of a long password its ends are judged:
it is as good as the better of them.
"""

from __future__ import annotations

from boresight.services.words import comparison_key

LEAST_GUESSES = 1e8  # zxcvbn's score 3: safe against guessing at the rate that logging in allows, many times over
JUDGED_LETTERS = 40  # at either end; the costliest text of this length takes 0.1 s
SHORTEST_NAME = 3  # a shorter one is part of words in half of all sentences: it counts where it stands as a word

CONTAINS_NAME = "The password contains the log-in name or the printed name; use one that does not."


def guessable(password: str, names: tuple[str, ...] = ()) -> str | None:
    """Say why a password is guessed early; None when it is not.

    Parameters
    ----------
    names
        Of the person: the log-in name and the printed one, whole and by their words.
    """
    known = _parts(names)
    plain = comparison_key(password)
    letters = "".join(letter for letter in plain if letter.isalnum())
    for name in known:
        if any(form in text for form in (name, name[::-1]) for text in (plain, letters)):
            return CONTAINS_NAME
    if _words(plain) & {name for name in map(comparison_key, names) if len(name) < SHORTEST_NAME}:
        return CONTAINS_NAME
    ends = {plain[:JUDGED_LETTERS], plain[-JUDGED_LETTERS:], password[:JUDGED_LETTERS], password[-JUDGED_LETTERS:]}
    if len(plain) <= JUDGED_LETTERS:
        ends = {plain, password}
        strong = all(_guesses(end, known) >= LEAST_GUESSES for end in ends)
    else:
        strong = any(_guesses(end, known) >= LEAST_GUESSES for end in ends)
    if not strong:
        return (
            "The password is common, or made of common parts, and is guessed early; "
            "use several words that do not belong together."
        )
    return None


def _words(text: str) -> set[str]:
    """Return the words of a text, whatever stands between them."""
    return set("".join(letter if letter.isalnum() else " " for letter in text).split())


def _parts(names: tuple[str, ...]) -> list[str]:
    """Return the names and their words, folded, that are long enough to mean something."""
    whole = [comparison_key(name) for name in names]
    joined = ["".join(letter for letter in name if letter.isalnum()) for name in whole]
    words = [word for name in whole for word in name.split() if len(word) > SHORTEST_NAME]
    return sorted({part for part in (*whole, *joined, *words) if len(part) >= SHORTEST_NAME})


def _guesses(text: str, known: list[str]) -> float:
    """Estimate after how many guesses a text falls."""
    from zxcvbn import zxcvbn  # noqa: PLC0415 - its lists take 60 ms to read, and few processes set passwords

    return float(zxcvbn(text, user_inputs=["boresight", *known])["guesses"])
