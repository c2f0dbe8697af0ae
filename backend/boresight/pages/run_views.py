"""How a reader looks at a part's charts, all of it in the address: axis, scale, tail; and the facts that stand beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlencode

from starlette.datastructures import QueryParams

from boresight.figures.course import course_of, settled_step
from boresight.figures.helpful_data import helpful_data, weakest_words
from boresight.figures.rms_tail import Tail, tail_of
from boresight.verdicts.numbers import MISSING, count, number, percent, urad
from boresight.verdicts.verdict import sigma_of_rms

Result = Mapping[str, Any]
Rows = list[tuple[str, str, str]]

ALIGNS = {"frame": "frame", "time": "hours since the first frame", "update": "update"}
SCALES = ("log", "linear")


@dataclass(frozen=True)
class View:
    """What the address asks for, as far as it can be had.

    Parameters
    ----------
    align, aligns
        What the axis of a sequential run counts, and what it may count; nothing to choose for a batch.
    scale
        Of the axes that can be seen on both, log or linear.
    tail_from
        Where the tail begins, None where the run itself says.
    """

    align: str
    aligns: Mapping[str, str]
    scale: str
    tail_from: float | None

    @property
    def query(self) -> str:
        """Return what a figure's address needs of it."""
        asked = {"align": self.align if self.align != "frame" else None, "tail_from": self.tail_from}
        return urlencode(
            {name: f"{value:g}" if isinstance(value, float) else value for name, value in asked.items() if value}
        )


def view_of(query: QueryParams, result: Result | None) -> View:
    """Read the view; what cannot be had falls back to the usual one."""
    history = (result or {}).get("history") or {}
    aligns = {name: words for name, words in ALIGNS.items() if history and (name != "time" or history.get("time_utc"))}
    align, scale = query.get("align", "frame"), query.get("scale", "log")
    return View(
        align=align if align in aligns else "frame",
        aligns=aligns,
        scale=scale if scale in SCALES else "log",
        tail_from=_number(query.get("tail_from", "")) if history else None,
    )


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def course_facts(result: Result | None) -> Rows:
    """Say when a run settled, what its cost came to, and how far it still stepped: term, value, meaning."""
    course = course_of(result or {})
    if result is None or course is None:
        return []
    first, steps = settled_step(result), f"{count(len(course.x))} {course.axis}s on record"
    running = result.get("status") == "running"
    settled = f"{course.axis} {course.x[first]:.6g}" if first is not None else ("not yet" if running else "not settled")
    rows = [("Settled at", settled, f"Within three final sigmas of the end from there on; {steps}.")]
    if course.axis == "iteration":
        cost = course.series("cost")
        rows.append(
            ("Cost", f"{number(cost[0])} → {number(cost[-1])}", "Half of chi-square, at the start and at the end.")
        )
    return rows


def tail_facts(result: Result | None, view: View) -> tuple[Tail | None, Rows]:
    """Set the errors of a run beside each other, each with its 3-sigma: on the data fitted, and never mixed in, held out."""
    if not result:
        return None, []
    tail = tail_of({**result, "tail_from": view.tail_from})
    rms, arcs = result.get("rms_arc_rad") or {}, result.get("pairs")
    rows = [
        ("Fitted data, old parameters", _with_reach(rms.get("initial"), arcs), "The sensor's parameters at launch."),
        ("Fitted data, new parameters", _with_reach(rms.get("final"), arcs), f"{count(arcs)} arcs."),
    ]
    if tail is not None:
        window = f"{tail.axis} {tail.start:.6g} to {tail.end:.6g}, {count(tail.points)} updates on record"
        rows.append(("Tail, mean over its window", _with_reach(tail.tail_rad, arcs), f"{window}."))
        rows.append(
            ("Aggregate, at the end", _with_reach(tail.aggregate_rad, arcs), "Each frame under the parameters it had.")
        )
    return tail, rows + _held_out(result)


def _held_out(result: Result) -> Rows:
    held_out = result.get("validation") or {}
    rms = held_out.get("rms_arc_rad") or {}
    if not rms:
        return [("Held-out data", MISSING, "No validation set was given: launch with one to have this answer.")]
    arcs, share = held_out.get("common_pairs"), percent((held_out.get("availability") or {}).get("final"))
    kept = f" {count(arcs)} arcs." if arcs is not None else " σ not kept."
    return [
        (
            "Held-out data, old parameters",
            _with_reach(rms.get("initial"), arcs),
            f"{count(held_out.get('frames'))} frames never fitted.{kept}",
        ),
        (
            "Held-out data, new parameters",
            _with_reach(rms.get("final"), arcs),
            f"{share} of these frames available.{kept}",
        ),
    ]


def _with_reach(rms_rad: float | None, arcs: float | None) -> str:
    """Write an RMS in microradians with its 3-sigma."""
    sigma = sigma_of_rms(rms_rad, arcs)
    return urad(rms_rad) if sigma is None else f"{urad(rms_rad)} ± {urad(3 * sigma, 2)}"


def sight_facts(result: Result | None) -> tuple[Rows, list[str]]:
    """Say what the data see least of, and what would help."""
    seen = (result or {}).get("observability") or {}
    if not result or not seen.get("singular_values"):
        return [], []
    spread = seen.get("sigma_of_direction") or [None]
    known = f"{number(spread[-1], 3)} typical σ" if spread[-1] is not None else "not determined"
    condition = number(seen.get("condition_number")) if seen.get("condition_number") is not None else "infinite"
    rows = [
        ("Weakest direction", weakest_words(result) or MISSING, str((seen.get("weakest") or {}).get("sentence") or "")),
        (
            "Known to",
            known,
            "One sigma along it, in units of the spread from one such sensor to the next; below 0.5 it is seen.",
        ),
        ("Condition number", condition, "Largest singular value over the smallest."),
    ]
    return rows, helpful_data(result)
