"""The run page: the verdict in a line, and below it one of six parts, the only one that is loaded.

The first part, Result, has the four views that decide, the next step, and what changed. What is for research is folded away
in its part. While a run computes the page is marked PARTIAL and follows the event stream. It never shows a parameter
without its sigma. The word of a tab is the worst that its part shows; the keys 1 to 6 open them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple
from urllib.parse import urlencode

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, Response
from markupsafe import Markup
from starlette.datastructures import QueryParams

from boresight.calibration.advice_kinds import Advice
from boresight.calibration.calibration import Calibration, Inputs
from boresight.calibration.exports import EXPORT_FORMATS
from boresight.calibration.options import CalibrationSettings, get_method_title
from boresight.console.access.credentials import get_times
from boresight.console.access.dependencies import Reading, Who, csrf, get_server
from boresight.console.approvals import gates
from boresight.console.approvals import queries as approval_queries
from boresight.console.approvals.pages.gates import assess_set
from boresight.console.fleet.tables import Sensor
from boresight.console.notes import queries as note_queries
from boresight.console.notes import service as notes
from boresight.console.pages.formats import get_level, short_hash, time_element, words
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import attempt, redirect, redirect_refused, render
from boresight.console.parameter_sets import queries as set_queries
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries as run_queries
from boresight.console.runs import service as runs
from boresight.console.runs.pages.choice import make_choice_part
from boresight.console.runs.pages.frames import make_frames_part
from boresight.console.runs.pages.list import compute_run_seconds, read_names
from boresight.console.runs.pages.live import StateNotice, make_live_part, make_log_part
from boresight.console.runs.pages.origin import make_origin
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.console.telemetry.validation_age import explain_old_validation
from boresight.console.uplinks.stations import make_workflow
from boresight.errors import NotFoundError
from boresight.estimation.statistics.observability import WEAK
from boresight.figures import CHAPTERS, WIDE, Figure
from boresight.figures.charts.matching import why_no_matching
from boresight.figures.charts.observability import helpful_data, weakest_words
from boresight.figures.charts.shadow import SHADOW
from boresight.figures.charts.smoothed import SMOOTHED
from boresight.figures.report import calibrate_command
from boresight.figures.style.axes import ALIGNMENTS
from boresight.figures.tables import (
    cause_rows,
    find_shown_set,
    flight_rows,
    flight_tolerance,
    interval_rows,
    match_counts,
    match_facts,
    minimum_rows,
    model_test_rows,
    parameter_rows,
    reason_tables,
    removed_count,
    removed_rows,
    side_by_side,
    star_rows,
    to_flag,
    unseen_rows,
)
from boresight.platform.actors import Actor
from boresight.platform.db.sessions import Session
from boresight.platform.db.times import TimeStyle
from boresight.verdicts.answers import Headline, make_four_views, make_headline
from boresight.verdicts.gates.judgement import gate_rows
from boresight.verdicts.history import RmsTail, interval_of_fit, read_history, settled_step, summarise_tail
from boresight.verdicts.numbers import MISSING, count, duration, number, percent, urad_between
from boresight.verdicts.remedies import Remedy, list_remedies
from boresight.verdicts.verdict import (
    PartVerdict,
    judge_parts,
    list_rms,
    make_verdict_marks,
    parse_run_summary,
    prospects,
    trust_marks,
    why_absent,
)


def list_provenance(run: Run, result: Calibration | None) -> list[tuple[str, Any]]:
    """List the content addresses and versions that reproduce the run."""
    inputs = result.inputs if result else Inputs()
    hashes = [(f"{name} SHA-256", _hash(value)) for name, value in inputs.sha256s.items()]
    versions = ", ".join(f"{name} {value}" for name, value in inputs.versions.items())
    timing = ", ".join(f"{name.replace('_', ' ')} {duration(value)}" for name, value in _timing(result))
    left_out = list_left_out(result) if result else []
    return [
        *hashes,
        ("Left out", "; ".join(left_out) or MISSING),
        ("Result SHA-256", short_hash(run.result_sha256) if run.result_sha256 else MISSING),
        ("Versions", versions or MISSING),
        ("Time spent", timing or MISSING),
    ]


def list_left_out(result: Calibration) -> list[str]:
    """Say what was left out, of how many: an exposure is one image, and a frame is left out where all of its are."""
    used = {"exposures": result.exposures, "stars": result.stars}
    lost = {what: sum(one.count for one in result.left_out if one.what == what) for what in used}
    return [
        f"{count(one.count)} of {count(used[one.what] + lost[one.what])} {one.what}: {one.reason}"
        if one.what in used
        else f"{count(one.count)} {one.what}: {one.reason}"
        for one in result.left_out
    ]


def _timing(result: Calibration | None) -> list[tuple[str, float]]:
    return [(name, value) for name, value in (result.timing_s if result else {}).items() if value is not None]


def _hash(value: Any) -> Markup | str:
    return short_hash(str(value)) if value else MISSING


def write_command(review: RunReview) -> str:
    """Write the command line that computes this run again from the files that the page offers."""
    run, settings, prior = review.run, CalibrationSettings.parse(review.run.settings), None
    if run.prior_run_id is not None:
        prior = f"run-{run.prior_run_id}.json"
        use = review.result.prior if review.result else None
        if use is not None and use.drift_sigma and settings.prior_age_days is None:
            # Which the rows of its sets told where its result does not.
            settings = replace(settings, prior_age_days=use.age_days)
    words = calibrate_command(
        [one.name for one in (review.data, *review.further)],
        f"run-{run.id}.sensor.json",
        settings,
        review.validation.name if review.validation else None,
        f"run-{run.id}.json",
        prior,
    )
    return " \\\n  ".join(words)


Rows = list[tuple[str, str, str]]

SCALES = ("log", "linear")


@dataclass(frozen=True)
class RunView:
    """The view that the address asks for, as far as it exists."""

    align: str
    aligns: Mapping[str, str]
    scale: str
    tail_from: float | None

    @property
    def query(self) -> str:
        """Return the part of the view for a figure's address."""
        asked = {"align": self.align if self.align != "frame" else None, "tail_from": self.tail_from}
        return urlencode(
            {name: f"{value:g}" if isinstance(value, float) else value for name, value in asked.items() if value}
        )


def read_run_view(query: QueryParams, result: Calibration | None) -> RunView:
    """Read the view; invalid values fall back to the defaults."""
    history = result.history if result else None
    aligns = {name: words for name, words in ALIGNMENTS.items() if history and (name != "time" or history.time_utc)}
    align, scale = query.get("align", "frame"), query.get("scale", "log")
    return RunView(
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


def list_history_facts(result: Calibration | None) -> Rows:
    """Say when a run settled, what its cost came to, and how far it still stepped: term, value, meaning."""
    history = read_history(result) if result else None
    if result is None or history is None:
        return []
    first, steps = settled_step(result), f"{count(len(history.x))} {history.axis}s stored"
    running = result.status == "running"
    settled = (
        f"{history.axis} {history.x[first]:.6g}" if first is not None else ("not yet" if running else "not settled")
    )
    rows = [
        (
            "Settled at",
            settled,
            f"From here on, all values stay within three final sigmas of the final values; {steps}.",
        )
    ]
    if history.axis == "iteration":
        cost = history.cost
        rows.append(
            ("Cost", f"{number(cost[0])} → {number(cost[-1])}", "Half of chi-square, at the start and at the end.")
        )
    return rows


def tail_facts(result: Calibration | None, view: RunView) -> tuple[RmsTail | None, Rows]:
    """Set the errors of a run beside each other, each with its 95 % interval: on fitted data, and on the validation set."""
    if result is None:
        return None, []
    tail = summarise_tail(result, view.tail_from)
    old, new = list_rms(result.evaluation, result.rms_arc_rad, result.pairs)
    rows = [
        ("Fitted data, old parameters", old, "The sensor's parameters at launch."),
        ("Fitted data, new parameters", new, f"{count(result.pairs)} arcs."),
    ]
    if tail is not None:
        window = f"{tail.axis} {tail.start:.6g} to {tail.end:.6g}, {count(tail.points)} updates on record"
        rows.append(("Tail, mean over its window", _of_fit(result, tail.tail_rad), f"{window}."))
        said = "Each frame with the parameters at that time."
        rows.append(("Aggregate, at the end", _of_fit(result, tail.aggregate_rad), said))
    return tail, rows + _list_validation_facts(result)


def _list_validation_facts(result: Calibration) -> Rows:
    validation = result.validation
    if validation is None:
        return [("Validation data", MISSING, "No validation set was given: launch a run with one to get this answer.")]
    arcs, share = validation.common_pairs, percent(validation.availability.final)
    old, new = list_rms(validation, validation.rms_arc_rad, arcs)
    kept = f" {count(arcs)} arcs." if arcs is not None else ""
    return [
        (
            "Validation data, old parameters",
            old,
            f"{count(validation.frames)} frames never fitted.{kept}",
        ),
        (
            "Validation data, new parameters",
            new,
            f"{share} of these frames available.{kept}",
        ),
    ]


def _of_fit(result: Calibration, rms_rad: float | None) -> str:
    return urad_between(rms_rad, interval_of_fit(result, rms_rad))


def sight_facts(result: Calibration | None) -> tuple[Rows, list[str]]:
    """Describe what the data determine worst, and what would help."""
    seen = result.observability if result else None
    if result is None or seen is None or not seen.singular_values:
        return [], []
    spread = seen.sigma_of_direction or [None]
    known = f"{number(spread[-1], 3)} typical σ" if spread[-1] is not None else "not determined"
    condition = number(seen.condition_number) if seen.condition_number is not None else "infinite"
    rows = [
        ("Weakest direction", weakest_words(result) or MISSING, seen.weakest.sentence),
        (
            "Known to",
            known,
            (
                f"One sigma along this direction, in units of the spread between sensors of this kind; it counts as determined "
                f"up to {WEAK:g}."
            ),
        ),
        ("Condition number", condition, "Largest singular value over the smallest."),
    ]
    return rows, helpful_data(result)


@dataclass(frozen=True)
class RunReview:
    """The inputs of a part: the request, the actor, the run and its result so far."""

    request: Request
    session: Session
    actor: Actor
    run: Run
    sensor: Sensor
    data: TelemetrySet
    further: Sequence[TelemetrySet]
    validation: TelemetrySet | None
    result: Calibration | None

    @property
    def is_void(self) -> bool:
        """Whether the partial result of the run is void."""
        return self.run.state in TERMINAL_RUN_STATES and self.run.result_sha256 is None

    @property
    def why_nothing(self) -> str:
        """Say why there is no result, to follow `No verdict: `."""
        return {
            "QUEUED": "the run has not started.",
            "RUNNING": "the first frames are being read.",
        }.get(self.run.state, f"the run ended as {self.run.state} before it had a result.")


def make_result_part(review: RunReview) -> dict[str, Any]:
    """Gather the four views, and old and new values."""
    found = review.result if review.result and review.result.parameters else None
    return {
        "views": () if review.is_void else make_four_views(review.result),
        "rows": parameter_rows(found) if found else [],
        "uncertainty": make_uncertainty(review.result),
        **make_origin(review.run, (review.data, *review.further), None if review.is_void else review.result),
        "remedies": [
            (remedy.label, make_remedy_address(review.run, remedy)) for remedy in list_remedies(review.result)
        ],
    }


def make_remedy_address(run: Run, remedy: Remedy) -> str:
    """Return the address of a launch form that is filled in with a remedy, or of the part of the run that leads on."""
    if remedy.part:
        return f"/runs/{run.id}?part={remedy.part}#choice"
    freed = [] if remedy.free is None else [(f"free-{run.sensor_id}", name) for name in remedy.free]
    return f"/runs/new?{urlencode([('clone', str(run.id)), *remedy.settings.items(), *freed])}"


def make_uncertainty(result: Calibration | None) -> dict[str, Any]:
    """Gather what sigmas do not tell of: process noise and where it is from, misfit, other minima, and asymmetric intervals."""
    found = result or Calibration(status="running")
    return {
        "process_noise": found.process_noise.sentence if found.process_noise else "",
        "misfit": found.misfit.sentence if found.misfit else "",
        "minima": found.minima.sentence if found.minima else "",
        "others": minimum_rows(found),
        "intervals": interval_rows(found),
    }


def make_convergence_part(review: RunReview) -> dict[str, Any]:
    """Gather the history of the estimate, and tail, aggregate and validation errors."""
    view = read_run_view(review.request.query_params, review.result)
    tail, facts = tail_facts(review.result, view)
    return {"view": view, "course": list_history_facts(review.result), "errors": facts, "tail": tail}


def make_distortion_part(review: RunReview) -> dict[str, Any]:
    """Gather which camera the data ask for."""
    return make_choice_part(review.request, review.session, review.actor, review.run)


def make_observability_part(review: RunReview) -> dict[str, Any]:
    """Gather what the data determine, and which data would help."""
    facts, helpful = sight_facts(review.result)
    return {"facts": facts, "helpful": helpful}


def make_evidence_part(review: RunReview) -> dict[str, Any]:
    """Gather examination, residuals and matching; one frame in their place where the address asks for it."""
    if "frame" in review.request.query_params:
        return make_frames_part(review.session, review.request, review.run)
    return {
        "trust": make_trust_part(review.result, review.why_nothing),
        "matching": make_matching_part(review.result, review.why_nothing),
    }


def make_record_part(review: RunReview) -> dict[str, Any]:
    """Gather who ran what, where the numbers come from, the log and the notes."""
    by = read_names(review.session).person(review.run.launched_by)
    return {
        "header": make_run_header(review, by, get_times(review.request)),
        "notes": notes.list_notes(review.session, "runs", review.run.id),
        **make_provenance_part(review),
        **make_log_part(review.request, review.session, review.run),
    }


def make_provenance_part(review: RunReview) -> dict[str, Any]:
    """Gather where the numbers come from, and the command that makes them again."""
    return {
        "provenance": list_provenance(review.run, review.result),
        "validation": review.validation,
        "data": review.data,
        "further": review.further,
        "command": write_command(review),
        "settings_json": json.dumps(review.run.settings, indent=2, sort_keys=True),
    }


def make_trust_part(result: Calibration | None, why_nothing: str) -> dict[str, Any]:
    """Gather what the trust part shows; `why_nothing` is said where the run has no result."""
    if result is None:
        said = f"No examination: {why_nothing}"
        return {"marks": [], "tests": [], "causes": [], "unseen": [], "said": said, "examined": False}
    return {
        "marks": trust_marks(result),
        "tests": model_test_rows(result),
        "causes": cause_rows(result),
        "unseen": unseen_rows(result),
        "said": why_absent(result, ""),
        "prospects": prospects(result),
        "examined": result.trust is not None,
        "stars": star_rows(result),
        "to_flag": to_flag(result),
        "why_no_stars": why_absent(result, "stars"),
        "stars_in_all": count(result.trust.stars_in_all if result.trust else None),
    }


#: Removed stars on a page; the file has more.
MOST_REMOVED_SHOWN = 200


def make_matching_part(result: Calibration | None, why_nothing: str) -> dict[str, Any]:
    """Gather what the matching part shows."""
    found = result or Calibration(status="running")
    matching = found.matching
    return {
        "counts": match_counts(matching) if matching else [],
        "said": why_no_matching(found) if result else f"No matching: {why_nothing}",
        "facts": match_facts(matching) if matching else [],
        "reasons": reason_tables(matching) if matching else [],
        "flight": flight_rows(found),
        "tolerance": flight_tolerance(found),
        "side_by_side": side_by_side(found),
        "removed": {
            "count": removed_count(found),
            "rows": removed_rows(found, MOST_REMOVED_SHOWN),
            "more": len(found.removed) > MOST_REMOVED_SHOWN,
        },
    }


def list_verdict_marks(result: Calibration | None) -> list[Any]:
    """Return the marks of the verdict strip; none where nothing was estimated."""
    return make_verdict_marks(result) if result and result.parameters else []


#: Where what an older address names is now: the part, and the place in it.
FORMER = {
    "estimate": ("result", ""),
    "summary": ("result", ""),
    "rms": ("convergence", "figure-rms"),
    "residuals": ("evidence", "residuals"),
    "trust": ("evidence", "examination"),
    "matching": ("evidence", "matches"),
    "frames": ("evidence", "frame-browser"),
    "choice": ("distortion", "choice"),
    "log": ("record", "log"),
    "provenance": ("record", "provenance"),
    "notes": ("record", "notes"),
}


def get_former_address(run_id: int, former: str, query: Mapping[str, str]) -> str:
    """Return where an older address of a part leads now, with the view that it asks for."""
    part, place = FORMER[former]
    kept = {**({"frame": ""} if former == "frames" else {}), **query, "part": part}
    if part == "result":
        del kept["part"]
    return f"/runs/{run_id}{'?' + urlencode(kept) if kept else ''}{'#' + place if place else ''}"


@dataclass(frozen=True)
class RunTab:
    """A part's name, title and address, and the level and word of its verdict; no word where there is nothing to judge."""

    part: str
    title: str
    href: str
    current: bool
    level: str
    word: str


def list_tabs(run_id: int, chosen: str, result: Calibration | None, notes: int = 0) -> list[RunTab]:
    """Lay out the tabs of a run; `notes` is how many there are."""
    tabs, judged = [], judge_parts(result)
    if notes:
        judged["record"] = PartVerdict("standby", f"{count(notes)} note{'s' * (notes != 1)}")
    for name, part in PARTS.items():
        verdict = judged.get(name, PartVerdict())
        address = f"/runs/{run_id}" if name == "result" else f"/runs/{run_id}?part={name}"
        tabs.append(RunTab(name, part.title, address, name == chosen, verdict.level, verdict.word))
    return tabs


class RunPart(NamedTuple):
    """A part of the page: its tab, the chapters of figures that it shows, and what gathers what its template names."""

    title: str
    chapters: tuple[str, ...]
    gather: Callable[[RunReview], dict[str, Any]]


PARTS = {
    "result": RunPart("Result", ("summary",), make_result_part),
    "convergence": RunPart("Convergence and RMS", ("convergence", "rms"), make_convergence_part),
    "distortion": RunPart("Distortion", ("distortion",), make_distortion_part),
    "observability": RunPart("Observability", ("observability",), make_observability_part),
    "evidence": RunPart("Evidence", ("trust", "residuals", "matching"), make_evidence_part),
    "record": RunPart("Record", (), make_record_part),
}


def list_part_figures(review: RunReview, part: str) -> dict[str, tuple[Figure, ...]]:
    """List the figures of a part by chapter; none of a run without a result, and none that the result has nothing for."""
    if review.is_void or "frame" in review.request.query_params:
        return {}
    found = review.result
    lacking = {
        "summary": found is None or not found.parameters,
        "trust": found is None or found.trust is None,
        "residuals": found is None or found.trust is None,
        "matching": found is None or found.matching is None,
    }
    figures = {chapter: () if lacking.get(chapter) else CHAPTERS[chapter] for chapter in PARTS[part].chapters}
    if found is None or not find_shown_set(found):
        figures = {chapter: tuple(one for one in kept if one is not SHADOW) for chapter, kept in figures.items()}
    if found is None or found.smoothed is None:
        figures = {chapter: tuple(one for one in kept if one is not SMOOTHED) for chapter, kept in figures.items()}
    return figures


def make_run_verdict(review: RunReview, notices: Sequence[StateNotice]) -> Headline:
    """Say how a run stands; of one without an estimate by its state and what explains that."""
    told = tuple(notice.sentence for notice in notices)
    if review.result is None or not review.result.parameters:
        kind = "No verdict" if review.run.state in TERMINAL_RUN_STATES else "No verdict yet"
        return Headline(review.run.state, review.run.state, f"{kind}: {review.why_nothing}", "", told)
    headline = make_headline(review.result)
    old = explain_old_validation([review.data, *review.further], review.validation)
    return replace(headline, warnings=(*told, *put_cause_first(headline.warnings, old)))


def put_cause_first(warnings: Sequence[str], old: str) -> tuple[str, ...]:
    """Put that the validation set is older than the data before the warning that it explains, if that is there."""
    said: list[str] = []
    for one in warnings:
        if old and isinstance(one, Advice) and one.code == "validation_rms":
            said.append(old)
        said.append(one)
    return tuple(said)


router = PageRouter(dependencies=[Depends(csrf)])


@dataclass(frozen=True)
class RunAction:
    """A button: whether it belongs on the page, and why it cannot be pressed."""

    offered: bool
    blocked: str | None = None


def list_run_actions(run: Run, actor: Actor) -> dict[str, RunAction]:
    """List the actions on a run, each with why the actor may not take it."""
    lacking = None if "analyst" in actor.roles else "Only an analyst may {}; ask an administrator for the role."
    create = lacking.format("create parameter sets") if lacking else _why_no_set(run)
    return {
        "cancel": RunAction(run.state in {"QUEUED", "RUNNING"}, lacking and lacking.format("cancel runs")),
        "create": RunAction(run.state == "SUCCEEDED", create),
    }


def _why_no_set(run: Run) -> str | None:
    """Return why no parameter set can be made from a finished run, or None where one can."""
    status = parse_run_summary(run.summary).status
    if status is None or status in parameter_sets.USABLE_STATUSES:
        return None
    return f"A result with status {words(status)} cannot become a parameter set."


def make_run_header(review: RunReview, by: str, times: TimeStyle) -> list[tuple[str, Any]]:
    """Lay out who ran what on which data, and when."""
    run, validation = review.run, review.validation
    unnamed = len(review.further) - MOST_SETS_NAMED
    more = f" and {unnamed} more" if unnamed > 0 else ""
    start = Markup('<a href="/runs/{0}">run #{0}</a>').format(run.prior_run_id) if run.prior_run_id else None
    if run.prior_set_id is not None:
        name = review.session.get_known(ParameterSet, run.prior_set_id).name
        start = Markup('<a href="/parameter-sets/{}">{}</a>').format(run.prior_set_id, name)
    return [
        ("Data", Markup(", ").join(map(_set_link, (review.data, *review.further[:MOST_SETS_NAMED]))) + more),
        *([("Starts from", start)] if start else []),
        ("Validation", _set_link(validation) if validation else "none"),
        ("Launched by", by),
        ("Launched", time_element(run.launched_utc, times)),
        ("Started", time_element(run.started_utc, times)),
        ("Ended", time_element(run.ended_utc, times)),
        ("Duration", duration(compute_run_seconds(run))),
        ("Attempt", count(run.attempt) if run.attempt else MISSING),
    ]


#: Further sets that the head of a record names; the passes have them all.
MOST_SETS_NAMED = 4


def _set_link(data: TelemetrySet) -> Markup:
    link = Markup('<a href="/telemetry/{}">{}</a> ').format(data.id, data.name)
    return link + short_hash(data.original_sha256)


@router.get("/runs/{run_id:int}", response_class=HTMLResponse)
def run_page(request: Request, session: Reading, actor: Who, run_id: int, part: str = "result") -> Response:
    """Show a run: its verdict, and one of its parts; a choice of a camera is a part of the run it is for."""
    if part not in PARTS and part not in FORMER:
        raise NotFoundError(f"A run has no part {part[:40]}; choose from {', '.join(PARTS)}.")
    if (choice_of := runs.get_run(session, run_id).choice_of) is not None:
        return redirect(f"/runs/{choice_of}?part=distortion#choice")
    if part in FORMER:
        return redirect(get_former_address(run_id, part, request.query_params))
    review = get_run_review(request, session, actor, run_id)
    run, result = review.run, review.result
    live, head = make_live_part(request, session, run), make_run_head(review)
    return render(
        request,
        "runs/run.html",
        run=run,
        terminal=run.state in TERMINAL_RUN_STATES,
        sensor=review.sensor,
        method=get_method_title(run.method),
        **head,
        **live,
        result=result,
        partial=run.result_sha256 is None,
        marks=list_verdict_marks(result),
        judged=make_run_verdict(review, live["notices"]),
        part=part,
        tabs=list_tabs(run_id, part, result, note_queries.count_notes(session, "runs", run_id)),
        camera_formats=[form for form in EXPORT_FORMATS.values() if not form.needs_attitudes],
        exposure_formats=[form.name for form in EXPORT_FORMATS.values() if form.needs_attitudes],
        no_result=review.why_nothing,
        wide=WIDE,
        figures=list_part_figures(review, part),
        **({"choice": None, "frames": None} | PARTS[part].gather(review)),
    )


def get_run_review(request: Request, session: Session, actor: Actor, run_id: int) -> RunReview:
    """Fetch a run with its sensor, its data and what it has found so far."""
    run = runs.get_run(session, run_id)
    validation = run.validation_set_id
    is_void = run.state in TERMINAL_RUN_STATES and run.result_sha256 is None  # what was computed does not count
    found = None if is_void else runs.find_calibration(session, get_server(request).blobs, run_id)
    return RunReview(
        request=request,
        session=session,
        actor=actor,
        run=run,
        sensor=session.get_known(Sensor, run.sensor_id),
        data=session.get_known(TelemetrySet, run.telemetry_set_id),
        further=run_queries.list_further_sets(session, run),
        validation=None if validation is None else session.get_known(TelemetrySet, validation),
        result=found,
    )


def make_run_head(review: RunReview) -> dict[str, Any]:
    """Gather what is above the tabs: the run's actions, its neighbours, and what comes next."""
    actions, made = list_run_actions(review.run, review.actor), find_parameter_set(review.session, review.run)
    assessed, policy = list_run_gates(review.session, made), get_server(review.request).policy
    return {
        "actions": actions,
        "blocked": sorted({action.blocked for action in actions.values() if action.offered and action.blocked}),
        "parameter_set": made,
        "gates": assessed,
        "workflow": make_workflow(review.session, review.actor, policy, made, review.run),
        "of_frames": review.data.frames,
        "neighbours": run_queries.read_neighbours(review.session, review.run.id),
    }


def list_run_gates(session: Session, made: ParameterSet | None) -> dict[str, Any] | None:
    """Read the newest gate report of a run's set, a row a gate; None where the run has no set, no rows before it is assessed."""
    if made is None:
        return None
    report = approval_queries.find_newest_report(session, made.id)
    if report is None:
        return {"report": None, "rows": []}
    found = gates.lay_waivers(session, report)
    return {"report": found, "rows": gate_rows(found.gates, found.blocking)}


def find_parameter_set(session: Session, run: Run) -> ParameterSet | None:
    """Return the set that was made from a run, if one was."""
    return set_queries.find_set_of_run(session, run.id)


@router.post("/runs/{run_id:int}/parameter-set")
async def create_parameter_set(request: Request, actor: Who, run_id: int) -> Response:
    """Make a candidate set from a run's result, and hold it against the gates."""
    blobs = get_server(request).blobs
    outcome = await attempt(request, partial(parameter_sets.create_from_run, actor=actor, blobs=blobs, run_id=run_id))
    if outcome.refusal is not None:
        return redirect_refused(f"/runs/{run_id}", outcome.refusal)
    made = outcome.made
    assessed = await assess_set(request, actor, made.id)
    if assessed.value is None:
        why = "" if assessed.refusal is None else f": {assessed.refusal.sentence}"
        return redirect(
            f"/parameter-sets/{made.id}", flash=f"{made.name} is a candidate, not assessed{why}", level="caution"
        )
    words = f"{made.name} is a candidate; the verdict of its gates is {assessed.value.verdict}."
    return redirect(f"/parameter-sets/{made.id}", flash=words, level=get_level(assessed.value.verdict), code="made")
