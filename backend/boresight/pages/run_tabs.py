"""The tabs of the run page: an address each, and a word where something is to be judged.

A word is the worst that the part shows, so that nobody has to open a tab to learn that it is as it should be. The keys 1
to 9 open the first nine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from boresight.figures.course import settled_step
from boresight.verdicts.numbers import count, number, urad
from boresight.verdicts.verdict import marks, trust_doubts, trust_level, verdict

Result = Mapping[str, Any]
Standing = tuple[str, str]

TITLES = {
    "summary": "Summary",
    "convergence": "Convergence",
    "rms": "RMS",
    "distortion": "Distortion",
    "observability": "Observability",
    "residuals": "Residuals",
    "trust": "Trust",
    "matching": "Matching",
    "frames": "Frames",
    "log": "Log",
    "provenance": "Provenance",
    "notes": "Notes",
}
FORMER = {"estimate": "summary"}  # what a part was called in older links
NOTHING: Standing = ("off", "")


@dataclass(frozen=True)
class Tab:
    """A part's name, title and address, and in a word how things stand there; no word where there is nothing to judge."""

    part: str
    title: str
    href: str
    current: bool
    level: str = "off"
    word: str = ""


def tabs_of(run_id: int, chosen: str, result: Result | None, notes: int = 0) -> list[Tab]:
    """Lay out the tabs of a run; `notes` is how many there are."""
    return [
        Tab(part, title, address_of(run_id, part), part == chosen, *_standing(part, result or {}, notes))
        for part, title in TITLES.items()
    ]


def address_of(run_id: int, part: str) -> str:
    """Return the address of a part."""
    return f"/runs/{run_id}" if part == "summary" else f"/runs/{run_id}?part={part}"


def _standing(part: str, result: Result, notes: int) -> Standing:
    """Say with a level and a word how a part stands."""
    if part == "notes" and notes:
        return "standby", count(notes)
    judge = JUDGES.get(part)
    return judge(result) if judge and result.get("parameters") else NOTHING


def _fit(result: Result) -> Standing:
    level = verdict(result).level
    return level, {"normal": "no reservation", "standby": "partial"}.get(level, "reservations")


def _course(result: Result) -> Standing:
    if result.get("status") == "running":
        return "standby", "moving"
    at = settled_step(result)
    return ("normal", "settled") if at is not None else ("caution", "not settled")


def _rms(result: Result) -> Standing:
    rms = (result.get("validation") or {}).get("rms_arc_rad") or result.get("rms_arc_rad") or {}
    before, after = rms.get("initial"), rms.get("final")
    if before is None or after is None:
        return NOTHING
    return ("normal" if after < before else "serious"), f"{urad(after, 3)} µrad"


def _observability(result: Result) -> Standing:
    mark = next(mark for mark in marks(result) if mark.question == "Weakest direction")
    return (mark.level, mark.word) if mark.word != "NO DATA" else NOTHING


def _residuals(result: Result) -> Standing:
    chi2, per_dof = result.get("chi2") or {}, result.get("chi2_per_dof")
    if per_dof is None or chi2.get("consistent") is None:
        return NOTHING
    return ("normal" if chi2["consistent"] else "caution"), f"χ² {number(per_dof, 3)}"


def _trust(result: Result) -> Standing:
    if not result.get("trust"):
        return NOTHING
    doubts = len(trust_doubts(result))
    return trust_level(result), f"{doubts} doubt{'s' * (doubts != 1)}" if doubts else "no doubt"


def _matching(result: Result) -> Standing:
    if not result.get("matching"):
        return NOTHING
    return ("normal", "rested") if result["matching"].get("rested") else ("caution", "not at rest")


JUDGES: dict[str, Callable[[Result], Standing]] = {
    "summary": _fit,
    "convergence": _course,
    "rms": _rms,
    "observability": _observability,
    "residuals": _residuals,
    "trust": _trust,
    "matching": _matching,
}
