"""Words that people give: a label, a reason, a comment. They stand in lists, logs and signed records."""

from __future__ import annotations

import unicodedata

from boresight.errors import RefusedInputError

LAYOUT = "\t\n\r"


def refuse_control_characters(**texts: str) -> None:
    """Refuse control characters other than tab and line ends: nobody sees them, and they end a text early elsewhere.

    Raises
    ------
    RefusedInputError
        Says which text has one and where.
    """
    for name, text in texts.items():
        for place, letter in enumerate(text, start=1):
            if unicodedata.category(letter) in {"Cc", "Cs"} and letter not in LAYOUT:
                named = name.replace("_", " ")
                raise RefusedInputError(
                    f"The {named} has the control character U+{ord(letter):04X} at place {place}; remove it."
                )
