"""The terms of the console, read from `docs/glossary.md`, and where they are explained.

A page that is rendered explains each term where it first stands in a label: a heading, part of a table, a fact, a group of fields;
and each letter, of a parameter and the σ beside it, wherever it stands as one (`data-parameter` has its name in the code).
There it is a link to the glossary, or the button that sorts the column, with the meaning at it, which `glossary.js` shows under
the pointer and at the focus.
"""

from __future__ import annotations

import html
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from boresight.resources import folder

LINE = re.compile(r"- \*\*(?P<names>[^*]+)\*\*: (?P<meaning>.+?\.)(?P<code>(?: `[\w.]+`)+)")
LABEL = re.compile(
    r'<(?:a class="sort"|button [^>]*data-sort=)[^>]*>(?P<column>[^<>]+)(?=<)'
    r'|<var data-parameter="(?P<parameter>\w+)">(?P<letter>.+?)</var>'
    r'|<(?:h[1-4]|dt|th|legend)\b(?![^>]*class="sr")[^>]*>\s*(?P<label>[^<>]+?)(?=\s*<)'
)
PARAMETERS = "Letters"  # the heading of what is no word: camera parameters and their σ
OTHERWISE = frozenset({"state", "term", "cause"})  # also of runs, of noise, of failures


@dataclass(frozen=True)
class GlossaryTerm:
    """One entry: its names, the first one leading, its meaning, the heading that it stands under, and its names in the code."""

    names: tuple[str, ...]
    meaning: str
    heading: str
    code_names: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """Its place on the glossary's page."""
        letters = unicodedata.normalize("NFKD", self.names[0].replace("σ", "sigma")).encode("ascii", "ignore").decode()
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
            code_names = tuple(re.findall(r"[\w.]+", found["code"]))
            terms.append(GlossaryTerm(names, re.sub("[*`]", "", found["meaning"]), heading, code_names))
    return tuple(terms)


@cache
def list_terms() -> Sequence[GlossaryTerm]:
    """Return every term, in the glossary's order."""
    return read_terms((folder("docs") / "glossary.md").read_text(encoding="utf-8"))


@cache
def terms_by_name() -> Mapping[str, GlossaryTerm]:
    """Return every term that is a word by each of its names, in small letters."""
    return {name.lower(): term for term in list_terms() if term.heading != PARAMETERS for name in term.names}


@cache
def terms_of_parameters() -> Mapping[str, GlossaryTerm]:
    """Return what explains a camera parameter, by its name in the code."""
    return {name: term for term in list_terms() if term.heading == PARAMETERS for name in term.code_names}


def find_term(label: str) -> GlossaryTerm | None:
    """Return the term that a label names, also in the plural."""
    word = label.lower()
    return None if word in OTHERWISE else terms_by_name().get(word) or terms_by_name().get(word.removesuffix("s"))


@cache
def _terms_in_words() -> re.Pattern[str]:
    """Return what finds terms in a label, the longest first, also in the plural."""
    names = sorted((name for name in terms_by_name() if name not in OTHERWISE), key=len, reverse=True)
    return re.compile(rf"(?<![\w-])(?:{'|'.join(map(re.escape, names))})s?(?![\w-])", re.IGNORECASE)


def mark_terms(page: str) -> str:
    """Explain each term of a page where it first stands in a label, each letter of a parameter everywhere."""
    seen: set[str] = set()

    def take(term: GlossaryTerm | None) -> str | None:
        """Return the attribute with the meaning of a term that was not explained yet."""
        if term is None or term.anchor in seen:
            return None
        seen.add(term.anchor)
        return f'data-meaning="{html.escape(term.meaning)}"'

    def link(found: re.Match[str]) -> str:
        term = find_term(found[0])
        meaning = take(term)
        return (
            found[0]
            if meaning is None or term is None
            else f'<a class="term" href="{term.address}" {meaning}>{found[0]}</a>'
        )

    def explain(name: str, letter: str) -> str:
        """Return a letter with its meaning, the first time as a link; without one where the name is of no camera here."""
        term = terms_of_parameters().get(name)
        if term is None:
            return f"<var>{letter}</var>"
        meaning = f'data-meaning="{html.escape(term.meaning)}"'
        first = take(term) is not None
        return (
            f'<a class="term" href="{term.address}" {meaning}><var>{letter}</var></a>'
            if first
            else f"<var {meaning}>{letter}</var>"
        )

    def mark(found: re.Match[str]) -> str:
        if name := found["parameter"]:
            return explain(name, found["letter"])
        if column := found["column"]:
            meaning = take(find_term(html.unescape(column)))
            return found[0] if meaning is None else f"{found[0].removesuffix(f'>{column}')} {meaning}>{column}"
        label = found["label"]
        return f"{found[0].removesuffix(label)}{_terms_in_words().sub(link, label)}"

    return LABEL.sub(mark, page)
