"""The parts of the run page, a tab and an address each: the estimate, the examination of its trust, and its matching."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.figures import CHAPTERS
from boresight.figures.evidence import marks
from boresight.figures.matching import MATCHING, why_no_matching
from boresight.figures.matching_table import (
    flight_rows,
    flight_tolerance,
    match_counts,
    match_facts,
    reason_tables,
    side_by_side,
)
from boresight.figures.numbers import count
from boresight.figures.shadow import SHADOW, shown
from boresight.figures.star_table import star_rows, to_flag
from boresight.figures.trust_marks import prospects, trust_doubts, trust_level, trust_marks
from boresight.figures.trust_parts import why_absent

TITLES = {"estimate": "Estimate", "trust": "Trust", "matching": "Matching"}

Result = Mapping[str, Any]


@dataclass(frozen=True)
class Tab:
    """A part's title and address, and in a word how things stand there; no word where there is nothing to judge."""

    title: str
    href: str
    current: bool
    level: str = "off"
    word: str = ""


def tabs_of(run_id: int, chosen: str, result: Result | None) -> list[Tab]:
    """Lay out the tabs of a run."""
    tabs = []
    for part, title in TITLES.items():
        href = f"/runs/{run_id}" if part == "estimate" else f"/runs/{run_id}?part={part}"
        tabs.append(Tab(title, href, part == chosen, *_standing(part, result or {})))
    return tabs


def _standing(part: str, result: Result) -> tuple[str, str]:
    """Say with a level and a word how a part stands."""
    if part == "trust" and result.get("trust"):
        doubts = len(trust_doubts(result))
        return trust_level(result), f"{doubts} doubt{'s' * (doubts != 1)}" if doubts else "no doubt"
    if part == "matching" and result.get("matching"):
        rested = bool(result["matching"].get("rested"))
        return ("normal", "rested") if rested else ("caution", "not at rest")
    return "off", ""


def trust_of(result: Result | None, why_nothing: str) -> dict[str, Any]:
    """Gather what the trust part shows; `why_nothing` is said where the run has no result."""
    if not result:
        return {"marks": [], "said": f"No examination: {why_nothing}", "figures": ()}
    examined = bool(result.get("trust"))
    return {
        "marks": trust_marks(result),
        "said": why_absent(result, ""),
        "prospects": prospects(result),
        "figures": CHAPTERS["trust"] if examined else (),
        "stars": star_rows(result),
        "to_flag": to_flag(result),
        "why_no_stars": why_absent(result, "stars"),
        "stars_in_all": count((result.get("trust") or {}).get("stars_in_all")),
    }


def matching_of(result: Result | None, why_nothing: str) -> dict[str, Any]:
    """Gather what the matching part shows."""
    matching = (result or {}).get("matching") or {}
    return {
        "counts": match_counts(matching) if matching else [],
        "said": why_no_matching(result) if result else f"No matching: {why_nothing}",
        "facts": match_facts(matching),
        "reasons": reason_tables(matching),
        "flight": flight_rows(result or {}),
        "tolerance": flight_tolerance(result or {}),
        "side_by_side": side_by_side(result or {}),
        "cycles": MATCHING if matching else None,
        "shadow": SHADOW if shown(result or {}) else None,
    }


def marks_of(result: Result | None) -> list[Any]:
    """Answer the verdict strip's questions, none where nothing was estimated."""
    return marks(result) if result and result.get("parameters") else []
