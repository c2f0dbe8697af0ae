"""Validation of labels, reasons, comments and names, which appear in lists, logs and signed records."""

from __future__ import annotations

import unicodedata

from boresight.errors import RefusedInputError

LAYOUT = "\t\n\r"
LONGEST_NAME = 255  # characters, the usual limit of file systems
LONGEST_TEXT = 2000  # characters of what a person writes with a record that stays
_HIDDEN_CATEGORIES = {
    "Cc",
    "Cf",
    "Cs",
    "Cn",
    "Co",
    "Zl",
    "Zp",
}  # Cf contains the marks that change the direction of writing
_BLANKS = frozenset({0x034F, 0x115F, 0x1160, 0x17B4, 0x17B5, 0x2800, 0x3164, 0xFFA0})  # invisible letters
_VARIATION_SELECTORS = (range(0x180B, 0x1810), range(0xFE00, 0xFE10), range(0xE0100, 0xE01F0))


def refuse_control_characters(**texts: str) -> None:
    """Refuse control characters other than tab and line ends, which are invisible and may truncate a text elsewhere."""
    for name, text in texts.items():
        for place, letter in enumerate(text, start=1):
            if unicodedata.category(letter) in {"Cc", "Cs"} and letter not in LAYOUT:
                named = name.replace("_", " ")
                raise RefusedInputError(
                    f"The {named} contains the control character U+{ord(letter):04X} at position {place}; remove it.",
                    code="control-character",
                )


def refuse_long(**texts: str) -> None:
    """Refuse texts that are too long for the lists and pages that show them."""
    for name, text in texts.items():
        if len(text) > LONGEST_TEXT:
            raise RefusedInputError(
                f"The {name.replace('_', ' ')} has {len(text)} characters; shorten it to {LONGEST_TEXT} at most.",
                code="text-too-long",
            )


def normal_name(what: str, text: str, longest: int = LONGEST_NAME) -> str:
    """Return a name in the one form in which it is stored and compared: NFKC, outer blanks removed, inner ones single spaces.

    Two names that look alike because one is composed, full-width or spaced differently have the same form, so a
    constraint on what is stored keeps them apart.
    """
    if len(text) <= 4 * longest:  # longer names are refused anyhow
        text = _normal_form(text)
    if len(text) > longest:
        raise RefusedInputError(f"The {what} has {len(text)} characters; shorten it to {longest} at most.")
    for place, letter in enumerate(text, start=1):
        if is_hidden(letter):
            raise RefusedInputError(
                f"The {what} has the character U+{ord(letter):04X} at place {place}, which is invisible or changes the "
                "direction of writing; remove it."
            )
    return text


def comparison_key(name: str) -> str:
    """Return the form for comparing names that people would confuse: normal form, without regard to case."""
    return _normal_form(_normal_form(name).casefold())


def _normal_form(text: str) -> str:
    """Return the NFKC form with single spaces; twice, since joining letters over a removed blank may compose them."""
    once = " ".join(part for part in unicodedata.normalize("NFKC", text).split(" ") if part)
    return unicodedata.normalize("NFKC", once)


def is_hidden(letter: str) -> bool:
    """Whether a character is invisible, or changes the direction of writing."""
    code = ord(letter)
    if unicodedata.category(letter) in _HIDDEN_CATEGORIES:
        return True
    return code in _BLANKS or any(code in selectors for selectors in _VARIATION_SELECTORS)
