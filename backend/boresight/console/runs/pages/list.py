"""The list of runs, whose chosen rows go to the comparison, and the presets with every version and who saved it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.calibration.options import METHODS, CalibrationSettings, get_method_title
from boresight.console.access import users
from boresight.console.access.dependencies import Reading, Who, csrf, same_for_roles
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet.pages.sensors import list_sensor_choices
from boresight.console.operation import RowWithFields
from boresight.console.pages.formats import instant, seconds_since
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import make_change, render
from boresight.console.pages.tables import (
    Table,
    TableColumn,
    accept_one,
    is_number,
    is_text,
    read_all,
    read_page,
    read_view,
    write_csv,
)
from boresight.console.runs import presets
from boresight.console.runs import queries as run_queries
from boresight.console.runs.pages.launch import differences
from boresight.console.runs.tables import RUN_STATES, Run, parse_progress, parse_settings
from boresight.console.telemetry import queries as telemetry_rows
from boresight.platform.db.sessions import Session
from boresight.verdicts.numbers import MISSING, NARROW_SPACE, number, urad, urad_between, urad_interval
from boresight.verdicts.verdict import WORD_OF_LEVEL, judge_result, parse_run_summary

RUNS = Table(
    "runs",
    "Runs",
    (
        TableColumn("state", "State", "state", csv=("state",)),
        TableColumn("run", "Run", "-run", head=True, csv=("run",)),
        TableColumn("label", "Label", "label", "label", csv=("label",)),
        TableColumn("sensor", "Sensor", "sensor", csv=("sensor",)),
        TableColumn("method", "Method", "method", csv=("method",)),
        TableColumn("data", "Data", "data", "label", csv=("telemetry_set",)),
        TableColumn("fit", "Fit", "", "verdict-words", csv=("status",)),
        TableColumn(
            "rms",
            "RMS",
            "rms",
            "num",
            "Arclength RMS before and after, unweighted, and below the 95 % interval of the one after; sorted by after",
            "µrad",
            csv=("rms_initial_arc_rad", "rms_final_arc_rad"),
        ),
        TableColumn(
            "validation",
            "Validation RMS",
            "validation",
            "num",
            "RMS of the validation set, before and after, and below the 95 % interval of the one after; sorted by after",
            "µrad",
            optional=True,
            csv=("validation_rms_initial_arc_rad", "validation_rms_final_arc_rad"),
        ),
        TableColumn("chi2", "χ² / dof", "-chi2", "num", csv=("chi2_per_dof",)),
        TableColumn("change", "Change", "change", "num", "Change of the RMS relative to the parameters at launch", "%"),
        TableColumn("frames", "Frames", "", "num", optional=True, csv=("frames",)),
        TableColumn("by", "By", "by", csv=("launched_by",)),
        TableColumn("started", "Started", "-started", csv=("launched_utc", "started_utc")),
        TableColumn("ended", "Ended", "-ended", optional=True, csv=("ended_utc",)),
        TableColumn("duration", "Duration", "", "num", csv=("duration_s",)),
    ),
    {
        "sensor": is_number,
        "sensor_name": is_text,
        "state": accept_one(RUN_STATES),
        "method": accept_one(METHODS),
        "data": is_number,
        "archived": accept_one({"1"}),
        "q": is_text,
    },
    "-run",
    kind="runs",
    chosen="runs",
)
OF_SUMMARY = (
    "status",
    "rms_initial_arc_rad",
    "rms_final_arc_rad",
    "validation_rms_initial_arc_rad",
    "validation_rms_final_arc_rad",
    "chi2_per_dof",
    "frames",
)

router = PageRouter()


@dataclass(frozen=True)
class RunNames:
    """The names behind the ids in a run's row."""

    sensors: Mapping[int, str]
    sets: Mapping[int, str]
    people: Mapping[int, str]

    def person(self, user_id: int | None) -> str:
        """Return a person's printed name, or the system's for a run that no person launched."""
        return self.people.get(user_id, f"user {user_id}") if user_id is not None else "system"


def read_names(session: Session, found: Iterable[Run] = (), *, sensors_of: Iterable[Any] | None = ()) -> RunNames:
    """Read the names of every person, and of the sensors and telemetry sets of these runs."""
    found = list(found)
    used = {set_id for run in found for set_id in (run.telemetry_set_id, run.validation_set_id) if set_id is not None}
    if sensors_of is None:
        return _names(session, None, used)
    return _names(session, {row.sensor_id for row in (*found, *sensors_of) if row.sensor_id is not None}, used)


def _names(session: Session, sensor_ids: Collection[int] | None, set_ids: Collection[int] | None) -> RunNames:
    """Read the names of every person, and of these sensors and telemetry sets; of all where None is given."""
    return RunNames(
        {} if sensor_ids == set() else sensor_queries.read_names(session, sensor_ids),
        {} if set_ids == set() else telemetry_rows.read_names(session, set_ids),
        {person.id: person.printed_name for person in users.list_users(session)},
    )


@dataclass(frozen=True)
class RmsCell:
    """An RMS before and after, the 95 % interval of the one after below it, and in the tooltip each with its own."""

    text: str
    interval: str = ""
    told: str = ""


@dataclass(frozen=True)
class RunLine:
    """One row of the list."""

    run: Run
    sensor: str
    data: str
    method: str
    by: str
    fit: str | None
    fit_level: str
    advice: str
    rms: RmsCell
    validation: RmsCell
    change: str
    frames: int | None
    chi2_per_dof: float | None
    fraction: float | None
    seconds: float | None


def make_run_line(run: Run, names: RunNames) -> RunLine:
    """Lay out a run; missing values are a dash."""
    summary = parse_run_summary(run.summary)
    before, after = summary.rms_initial_arc_rad, summary.rms_final_arc_rad
    valid_before, valid_after = summary.validation_rms_initial_arc_rad, summary.validation_rms_final_arc_rad
    valid_ends = summary.validation_rms_initial_interval_rad, summary.validation_rms_final_interval_rad
    level = judge_result(summary)
    return RunLine(
        run=run,
        sensor=names.sensors.get(run.sensor_id, str(run.sensor_id)),
        data=names.sets.get(run.telemetry_set_id, str(run.telemetry_set_id)),
        method=get_method_title(run.method),
        by=names.person(run.launched_by),
        fit=_fit(summary.status, level),
        fit_level=level,
        advice=summary.advice or "",
        rms=_make_rms_cell(before, after, summary.rms_initial_interval_rad, summary.rms_final_interval_rad),
        validation=_make_rms_cell(valid_before, valid_after, *valid_ends),
        frames=summary.frames,
        change=_change(before, after),
        chi2_per_dof=summary.chi2_per_dof,
        fraction=parse_progress(run.progress).fraction if run.state in {"RUNNING", "CANCELLING"} else None,
        seconds=compute_run_seconds(run),
    )


def _fit(status: str | None, level: str) -> str | None:
    """Describe how a fit ended, a converged one by the verdict of its page."""
    return WORD_OF_LEVEL.get(level, status) if status == "converged" else status


def _make_rms_cell(
    before: float | None, after: float | None, ends_before: Sequence[float] | None, ends_after: Sequence[float] | None
) -> RmsCell:
    if after is None:
        return RmsCell(MISSING)
    told = f"{urad_between(before, ends_before)} → {urad_between(after, ends_after)} µrad"
    return RmsCell(f"{urad(before)} → {urad(after)}", urad_interval(ends_after), told)


def _change(before: float | None, after: float | None) -> str:
    if not before or after is None:
        return MISSING
    percent = 100.0 * (after / before - 1.0)
    return f"{'+' if percent > 0 else ''}{number(round(percent, 1), 3)}{NARROW_SPACE}%"


def compute_run_seconds(run: Run) -> float | None:
    """Return how long a run has computed, to its end or to now."""
    if run.started_utc is None:
        return None
    if run.ended_utc is None:
        return seconds_since(run.started_utc)
    return (instant(run.ended_utc) - instant(run.started_utc)).total_seconds()


@router.get("/runs", response_class=HTMLResponse, dependencies=[Depends(same_for_roles)])
def runs_page(request: Request, session: Reading) -> HTMLResponse:
    """Show a page of runs."""
    view = read_view(request, RUNS)
    found = read_page(session, view, **view.hide_archived())
    names = read_names(session, found.rows)
    on_page = {run.id for run in found.rows}
    return render(
        request,
        "runs/runs.html",
        view=view,
        lines=[make_run_line(run, names) for run in found.rows],
        archived=run_queries.list_archived(session, on_page),
        last=found.last,
        elsewhere=[number for number in view.chosen if number not in on_page],
        choices=list_sensor_choices(session, view),
        states=RUN_STATES,
        methods=METHODS.values(),
    )


@router.get("/runs.csv")
def runs_csv(request: Request, session: Reading) -> Response:
    """Give every run of a view as CSV, in SI."""
    view = read_view(request, RUNS)
    names = _names(session, None, None)
    return write_csv(view, (_csv_row(run, names) for run in read_all(session, view, **view.hide_archived())))


def _csv_row(run: Run, names: RunNames) -> RowWithFields:
    line, summary = make_run_line(run, names), parse_run_summary(run.summary)
    told = {"run": run.id, "sensor": line.sensor, "telemetry_set": line.data, "launched_by": line.by}
    return RowWithFields(run, duration_s=line.seconds, **told, **{name: getattr(summary, name) for name in OF_SUMMARY})


preset_router = PageRouter(dependencies=[Depends(csrf)])

MOST_SHOWN = 500


@preset_router.get("/presets", response_class=HTMLResponse)
def presets_page(request: Request, session: Reading, actor: Who) -> HTMLResponse:
    """List every preset, each with what it changes of the usual settings."""
    saved = presets.list_presets(session, archived=True)
    usual = CalibrationSettings()
    changes = {offer.key: differences(usual, offer.chosen) for offer in presets.BUILT_IN}
    changes |= {str(row.id): differences(usual, parse_settings(row.document)) for row in saved}
    return render(
        request,
        "runs/presets.html",
        own=presets.BUILT_IN,
        saved=saved,
        changes=changes,
        people=read_names(session).people,
        may="analyst" in actor.roles,
    )


@preset_router.post("/presets/{preset_id:int}/archive", response_class=HTMLResponse)
async def archive(request: Request, actor: Who, preset_id: int) -> Response:
    """Archive a version."""
    change = partial(presets.archive_preset, actor=actor, preset_id=preset_id)
    said = "Archived: no longer available for new runs. Existing runs still refer to it."
    return await make_change(request, change, "/presets", said)
