"""The terms of the console, read from `docs/glossary.md`: what each means, and where on the glossary's page it stands."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from boresight.resources import folder

LINE = re.compile(r"- \*\*(?P<names>[^*]+)\*\*: (?P<meaning>.+\.)(?: `[\w.]+`)+")


@dataclass(frozen=True)
class GlossaryTerm:
    """One entry: its names, the first one leading, its meaning, and the heading that it stands under."""

    names: tuple[str, ...]
    meaning: str
    heading: str

    @property
    def anchor(self) -> str:
        """Its place on the glossary's page."""
        letters = unicodedata.normalize("NFKD", self.names[0]).encode("ascii", "ignore").decode()
        return "term-" + re.sub(r"\W+", "-", letters.lower())

    @property
    def address(self) -> str:
        """Where it is explained."""
        return f"/help/glossary#{self.anchor}"


def read_terms(text: str) -> Sequence[GlossaryTerm]:
    """Read the entries of a glossary, without the code names behind them."""
    terms, heading = [], ""
    for line in text.splitlines():
        heading = line.removeprefix("## ") if line.startswith("## ") else heading
        if (found := LINE.fullmatch(line)) is not None:
            names = tuple(found["names"].split(", "))
            terms.append(GlossaryTerm(names, re.sub("[*`]", "", found["meaning"]), heading))
    return tuple(terms)


@cache
def list_terms() -> Sequence[GlossaryTerm]:
    """Return every term, in the glossary's order."""
    return read_terms((folder("docs") / "glossary.md").read_text(encoding="utf-8"))


@cache
def terms_by_name() -> Mapping[str, GlossaryTerm]:
    """Return every term by each of its names, in small letters."""
    return {name.lower(): term for term in list_terms() for name in term.names}
