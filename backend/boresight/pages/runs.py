"""The list of runs: what ran on which data, with what result; chosen rows go to the comparison.

The address holds the whole view: `?sensor=3&state=FAILED&method=sqrf&before=812`. Pages are cut by run number, newest
first, so that a page stays the page it was while new runs arrive.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.dependencies import Reading, current_actor
from boresight.figures.numbers import MISSING, NARROW_SPACE, number, urad
from boresight.pages.formats import instant, seconds_since
from boresight.pages.methods import METHODS, title_of
from boresight.pages.rendering import render
from boresight.services import runs, sensors, telemetry_sets, users
from boresight.services.fleet import level_of_result
from boresight.store.sessions import Session
from boresight.store.tables import RUN_STATES, Run

ROWS_A_PAGE = 50
CSV_ROWS_A_READ = 500
CSV_COLUMNS = (
    "run",
    "label",
    "sensor",
    "method",
    "telemetry_set",
    "state",
    "status",
    "rms_initial_arc_rad",
    "rms_final_arc_rad",
    "chi2_per_dof",
    "launched_by",
    "launched_utc",
    "started_utc",
    "ended_utc",
)

router = APIRouter(dependencies=[Depends(current_actor)])


@dataclass(frozen=True)
class Filters:
    """What of the list is shown; None shows all."""

    sensor: int | None
    state: str | None
    method: str | None

    @property
    def any(self) -> bool:
        """Tell whether anything is left out."""
        return bool(self.where)

    @property
    def where(self) -> dict[str, Any]:
        """Return the filters as the service takes them."""
        named = {"sensor_id": self.sensor, "state": self.state, "method": self.method}
        return {name: value for name, value in named.items() if value is not None}

    def query(self, before: int | None = None) -> str:
        """Return the address's query for these filters and a page."""
        named = {"sensor": self.sensor, "state": self.state, "method": self.method, "before": before}
        return urlencode({name: value for name, value in named.items() if value is not None})


def read_filters(sensor: str = "", state: str = "", method: str = "") -> Filters:
    """Read the filters from the address; what is no filter is left out, as an empty choice of the form is."""
    return Filters(
        sensor=int(sensor) if sensor.isdecimal() else None,
        state=state if state in RUN_STATES else None,
        method=method if method in {known.name for known in METHODS} else None,
    )


@dataclass(frozen=True)
class Names:
    """What the numbers in a run's row are called."""

    sensors: Mapping[int, str]
    sets: Mapping[int, str]
    people: Mapping[int, str]

    def person(self, user_id: int | None) -> str:
        """Return a person's printed name; what nobody in person launched was launched by the system."""
        return self.people.get(user_id, f"user {user_id}") if user_id is not None else "system"


def read_names(session: Session, found: Iterable[Run] = ()) -> Names:
    """Read the names of every sensor and person, and of the telemetry sets that these runs use."""
    set_ids = {
        set_id for run in found for set_id in (run.telemetry_set_id, run.validation_set_id) if set_id is not None
    }
    return Names(
        {sensor.id: sensor.name for sensor in sensors.list_sensors(session)},
        {set_id: telemetry_sets.get_telemetry_set(session, set_id).name for set_id in sorted(set_ids)},
        {person.id: person.printed_name for person in users.list_users(session)},
    )


@dataclass(frozen=True)
class Line:
    """One row of the list."""

    run: Run
    sensor: str
    data: str
    method: str
    by: str
    fit: str | None
    fit_level: str
    advice: str
    rms: str
    change: str
    chi2_per_dof: float | None
    fraction: float | None
    seconds: float | None


def line_of(run: Run, names: Names) -> Line:
    """Lay out a run; what it has not computed is a dash."""
    summary = run.summary or {}
    before, after = summary.get("rms_initial_arc_rad"), summary.get("rms_final_arc_rad")
    return Line(
        run=run,
        sensor=names.sensors.get(run.sensor_id, str(run.sensor_id)),
        data=names.sets.get(run.telemetry_set_id, str(run.telemetry_set_id)),
        method=title_of(run.method),
        by=names.person(run.launched_by),
        fit=summary.get("status"),
        fit_level=level_of_result(summary),
        advice=summary.get("advice") or "",
        rms=MISSING if after is None else f"{urad(before)} → {urad(after)}",
        change=_change(before, after),
        chi2_per_dof=summary.get("chi2_per_dof"),
        fraction=(run.progress or {}).get("fraction") if run.state in {"RUNNING", "CANCELLING"} else None,
        seconds=seconds_of(run),
    )


def _change(before: float | None, after: float | None) -> str:
    """Print how the RMS changed against the sensor's parameters at launch, in percent."""
    if not before or after is None:
        return MISSING
    percent = 100.0 * (after / before - 1.0)
    return f"{'+' if percent > 0 else ''}{number(round(percent, 1), 3)}{NARROW_SPACE}%"


def seconds_of(run: Run) -> float | None:
    """Return how long a run has computed, to its end or to now."""
    if run.started_utc is None:
        return None
    if run.ended_utc is None:
        return seconds_since(run.started_utc)
    return (instant(run.ended_utc) - instant(run.started_utc)).total_seconds()


@router.get("/runs", response_class=HTMLResponse)
def runs_page(
    request: Request,
    session: Reading,
    chosen: Annotated[Filters, Depends(read_filters)],
    before: str = "",
) -> HTMLResponse:
    """Show a page of runs, newest first."""
    before_id = int(before) if before.isdecimal() else None
    found = runs.list_runs(session, before_id=before_id, limit=ROWS_A_PAGE + 1, **chosen.where)
    shown = found[:ROWS_A_PAGE]
    names = read_names(session, shown)
    return render(
        request,
        "runs.html",
        lines=[line_of(run, names) for run in shown],
        sensors=sensors.list_sensors(session),
        states=RUN_STATES,
        methods=METHODS,
        chosen=chosen,
        query=chosen.query(),
        next_query=chosen.query(shown[-1].id) if len(found) > ROWS_A_PAGE else "",
        older=before_id is not None,
    )


@router.get("/runs.csv")
def runs_csv(session: Reading, chosen: Annotated[Filters, Depends(read_filters)]) -> Response:
    """Give every run that fits the filters as CSV, in SI."""
    found = list(_all_runs(session, chosen))
    names = read_names(session, found)
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(CSV_COLUMNS)
    writer.writerows(_csv_row(run, names) for run in found)
    headers = {"Content-Disposition": 'attachment; filename="runs.csv"'}
    return Response(text.getvalue(), media_type="text/csv", headers=headers)


def _all_runs(session: Session, chosen: Filters) -> Iterator[Run]:
    """Walk through every page of the list."""
    before_id = None
    while found := runs.list_runs(session, before_id=before_id, limit=CSV_ROWS_A_READ, **chosen.where):
        yield from found
        before_id = found[-1].id


def _csv_row(run: Run, names: Names) -> list[Any]:
    summary = run.summary or {}
    figures = [summary.get(key) for key in ("status", "rms_initial_arc_rad", "rms_final_arc_rad", "chi2_per_dof")]
    line = line_of(run, names)
    times = [run.launched_utc, run.started_utc, run.ended_utc]
    return [
        run.id,
        _plain(run.label),
        _plain(line.sensor),
        run.method,
        _plain(line.data),
        run.state,
        *figures,
        _plain(line.by),
        *times,
    ]


def _plain(text: str) -> str:
    """Keep a spreadsheet from taking a person's words for a formula."""
    return f"'{text}" if text[:1] in {"=", "+", "-", "@", "\t"} else text
