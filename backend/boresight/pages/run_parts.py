"""What each part of the run page shows, gathered only for the part that is open."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import Request

from boresight.figures import CHAPTERS, Figure
from boresight.figures.matching import MATCHING, why_no_matching
from boresight.figures.matching_table import (
    flight_rows,
    flight_tolerance,
    match_counts,
    match_facts,
    reason_tables,
    side_by_side,
)
from boresight.figures.parameter_table import parameter_rows
from boresight.figures.shadow import SHADOW, shown
from boresight.figures.star_table import star_rows, to_flag
from boresight.pages.run_frames import frames_of
from boresight.pages.run_log import log_of
from boresight.pages.run_provenance import command_of, provenance_of
from boresight.pages.run_views import course_facts, sight_facts, tail_facts, view_of
from boresight.services import notes
from boresight.services.actors import Actor
from boresight.store.sessions import Session
from boresight.store.tables import TERMINAL_RUN_STATES, Run, Sensor, TelemetrySet
from boresight.verdicts.numbers import count
from boresight.verdicts.verdict import marks, prospects, trust_marks, why_absent

Result = Mapping[str, Any]


@dataclass(frozen=True)
class Desk:
    """What a part is gathered from: who looks at which run, and what it has found so far.

    Parameters
    ----------
    result
        The calibration JSON, complete or so far; None where there is none, or where it does not count.
    """

    request: Request
    session: Session
    actor: Actor
    run: Run
    sensor: Sensor
    data: TelemetrySet
    validation: TelemetrySet | None
    result: Result | None

    @property
    def is_void(self) -> bool:
        """Tell whether what was computed does not count."""
        return self.run.state in TERMINAL_RUN_STATES and self.run.result_sha256 is None

    @property
    def why_nothing(self) -> str:
        """Say why there is no result, to follow `No verdict: `."""
        return {
            "QUEUED": "the run has not started.",
            "RUNNING": "the first frames are being read.",
        }.get(self.run.state, f"the run ended as {self.run.state} before it had a result.")


def part_of_page(desk: Desk, part: str) -> dict[str, Any]:
    """Gather what the template of a part names."""
    return GATHERED[part](desk)


def summary_of(desk: Desk) -> dict[str, Any]:
    """Gather old and new values; while the run computes its course stands beside them."""
    live = () if desk.run.state in TERMINAL_RUN_STATES else CHAPTERS["convergence"] + CHAPTERS["rms"]
    has_estimate = bool(desk.result and desk.result.get("parameters"))
    return {
        "rows": parameter_rows(desk.result) if desk.result and has_estimate else [],
        "figures": () if desk.is_void else (*live, *CHAPTERS["summary"]),
    }


def charts_of(name: str) -> Callable[[Desk], dict[str, Any]]:
    """Return what gathers the figures of a chapter."""

    def gather(desk: Desk) -> dict[str, Any]:
        figures: tuple[Figure, ...] = () if desk.is_void else CHAPTERS[name]
        return {"figures": figures}

    return gather


def convergence_of(desk: Desk) -> dict[str, Any]:
    """Gather the course of the estimate."""
    view = view_of(desk.request.query_params, desk.result)
    return {**charts_of("convergence")(desk), "view": view, "facts": course_facts(desk.result)}


def rms_of(desk: Desk) -> dict[str, Any]:
    """Gather tail, aggregate and held-out errors."""
    view = view_of(desk.request.query_params, desk.result)
    tail, facts = tail_facts(desk.result, view)
    return {**charts_of("rms")(desk), "view": view, "facts": facts, "tail": tail}


def observability_of(desk: Desk) -> dict[str, Any]:
    """Gather what the data see, and which would help."""
    facts, helpful = sight_facts(desk.result)
    return {**charts_of("observability")(desk), "facts": facts, "helpful": helpful}


def noted(desk: Desk) -> dict[str, Any]:
    """Gather the notes on the run."""
    return {"notes": notes.list_notes(desk.session, desk.actor, "runs", desk.run.id)}


def logged(desk: Desk) -> dict[str, Any]:
    """Gather the log."""
    return log_of(desk.request, desk.session, desk.run)


def origin_of(desk: Desk) -> dict[str, Any]:
    """Gather where the numbers come from, and the command that makes them again."""
    return {
        "provenance": provenance_of(desk.run, desk.result),
        "validation": desk.validation,
        "data": desk.data,
        "command": command_of(desk.run, desk.data, desk.validation),
        "settings_json": json.dumps(desk.run.settings, indent=2, sort_keys=True),
    }


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


GATHERED: dict[str, Callable[[Desk], dict[str, Any]]] = {
    "summary": summary_of,
    "convergence": convergence_of,
    "rms": rms_of,
    "distortion": charts_of("distortion"),
    "observability": observability_of,
    "residuals": charts_of("residuals"),
    "trust": lambda desk: {"trust": trust_of(desk.result, desk.why_nothing)},
    "matching": lambda desk: {"matching": matching_of(desk.result, desk.why_nothing)},
    "frames": lambda desk: frames_of(desk.session, desk.request, desk.run),
    "log": logged,
    "provenance": origin_of,
    "notes": noted,
}
