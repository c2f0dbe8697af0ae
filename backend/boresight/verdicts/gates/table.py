"""A gate report as people read it, on pages and in terminals: one row of words a gate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.verdicts.gates.gate import GATES
from boresight.verdicts.numbers import MINUS, MISSING, NARROW_SPACE, number, percent

SHARES = ("of frames", "of regions")


@dataclass(frozen=True)
class GateRow:
    """One gate of a report, in words."""

    name: str
    title: str
    status: str
    value: str
    interval: str
    limit: str
    marginal: str
    incumbent: str
    margin: str
    unit: str
    sentence: str
    notes: tuple[str, ...]
    blocking: bool
    waivable: bool


def gate_rows(report: Mapping[str, Any]) -> list[GateRow]:
    """Lay a report out, a row a gate."""
    return [_row(answer, answer["name"] in report["blocking"]) for answer in report["gates"]]


def _row(answer: Mapping[str, Any], blocking: bool) -> GateRow:
    name = answer["name"]
    met = {"PASS": "met", "MARGINAL": "nearly met", "FAIL": "not met"}.get(str(answer["met"]), MISSING)
    return GateRow(
        name=name,
        title=answer["title"],
        status=answer["status"],
        value=met if answer["met"] else in_unit(name, answer["value"]),
        interval=_between(name, answer["interval"] or answer["bounds"]),
        limit=threshold_text(name, answer["limit"]),
        marginal=threshold_text(name, answer["marginal"]),
        incumbent=in_unit(name, answer["incumbent"]),
        margin=in_unit(name, answer["margin"]),
        unit="" if GATES[name].unit in SHARES else GATES[name].unit,
        sentence=answer["sentence"],
        notes=tuple(_notes(answer)),
        blocking=blocking,
        waivable=answer["waivable"] and not answer["critical"],
    )


def _notes(answer: Mapping[str, Any]) -> list[str]:
    """Say what is special about an answer."""
    return [
        word
        for word, holds in (
            ("waived", answer["waived"]),
            ("critical", answer["critical"]),
            ("only observed", answer["observe_only"]),
            ("must have data", answer["must_have_data"] and not answer["critical"]),
        )
        if holds
    ]


def in_unit(name: str, value: float | None) -> str:
    """Write a gate's number in its unit, without it; a share as a percentage."""
    if value is None:
        return MISSING
    return percent(value) if GATES[name].unit in SHARES else number(value, 3)


def _between(name: str, interval: Any) -> str:
    """Write an interval; an unknown end is unbounded."""
    if interval is None:
        return MISSING
    low, high = interval
    left = f"{MINUS}∞" if low is None else in_unit(name, low)
    return f"{left} to {'∞' if high is None else in_unit(name, high)}"


def threshold_text(name: str, value: float | None) -> str:
    """Write a threshold with the side that is good."""
    direction = GATES[name].direction
    if direction == "met":
        return MISSING
    if value is None:
        return "none"
    if direction == "around":
        return f"{number(1 / value, 3)} to {number(value, 3)}"
    return f"{'≤' if direction == 'below' else '≥'}{NARROW_SPACE}{in_unit(name, value)}"
