"""What a sensor is to observe next: the form of the conditions, the plan with its forecast against the gate, and its CSV.

A plan is computed while its page is asked for and stored nowhere; the same conditions give the same plan, as a file too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, Response

from boresight.console.access.dependencies import KNOWN, Reading, Stars, csrf, get_server
from boresight.console.fleet import pointings
from boresight.console.fleet.tables import Sensor
from boresight.console.pages.page_router import PageRouter
from boresight.console.pages.rendering import (
    RefusalContext,
    read_again,
    read_number,
    read_texts,
    read_whole_number,
    render,
)
from boresight.console.parameter_sets import queries as set_rows
from boresight.errors import BoresightError, NotFoundError, RefusedInputError
from boresight.estimation.statistics.observability import WEAK
from boresight.platform.db.sessions import Session, open_reading, utc_after
from boresight.platform.web.paging import parse_row_id
from boresight.simulation.plans import PointingPlan
from boresight.simulation.pointings import Constraints
from boresight.sky.catalogue import Catalogue

router = PageRouter(dependencies=[Depends(csrf)])

MINUTES = 10.0
SET, RUN = "set", "run"


@dataclass(frozen=True)
class AskedNumber:
    """A number of the form: its name, label with unit, and hint."""

    name: str
    label: str
    hint: str

    @property
    def usual(self) -> str:
        """What stands there before anything was typed."""
        value = MINUTES if self.name == "minutes" else getattr(Constraints, self.name)
        return f"{value:g}"


TIMES = (
    AskedNumber("minutes", "Minutes", "Total duration of the plan."),
    AskedNumber("dwell_s", "Dwell (s)", "Duration of a pointing."),
    AskedNumber("exposure_s", "Exposure every (s)", "From one exposure to the next."),
    AskedNumber("visits", "Visits", "Maximum number of visits to a pointing."),
    AskedNumber("slew_deg_s", "Slew (°/s)", "Slew rate."),
    AskedNumber("settle_s", "Settling (s)", "Settling time after a slew."),
)
ANGLES = (
    AskedNumber("sun_deg", "Sun (°)", "Minimum angle."),
    AskedNumber("moon_deg", "Moon (°)", "Minimum angle."),
    AskedNumber("earth_deg", "Earth's limb (°)", "Minimum angle; needs the orbit."),
)
ORBIT = {"altitude_km": "Altitude (km)", "inclination_deg": "Inclination (°)", "node_hour": "Node (h)"}
CRITERIA = {"A": "A: smallest sum of variances", "D": "D: smallest volume of the confidence region"}


@router.get("/sensors/{sensor_id:int}/plan", response_class=HTMLResponse, dependencies=[KNOWN])
def plan_page(request: Request, session: Reading, sensor_id: int) -> HTMLResponse:
    """Show the form; what is known is the baseline, where stars measured it."""
    baseline = set_rows.find_baseline(session, sensor_id)
    known = f"{SET} {baseline.id}" if baseline is not None and baseline.run_id is not None else ""
    begins = utc_after(3600.0)[:14] + "00:00Z"
    return _page(request, sensor_id, {"known": known, "start_utc": begins}, None, None, session)


def _page(
    request: Request,
    sensor_id: int,
    typed: Mapping[str, str],
    found: PointingPlan | None,
    refusal: RefusalContext | None,
    session: Session,
) -> HTMLResponse:
    sensor = session.get_known(Sensor, sensor_id)
    sets, runs = pointings.list_known(session, sensor)
    return render(
        request,
        "fleet/plan.html",
        refused=refusal,
        sensor=sensor,
        typed=typed,
        found=found,
        refusal=refusal,
        sets=sets,
        runs=runs,
        times=TIMES,
        angles=ANGLES,
        orbit=ORBIT,
        criteria=CRITERIA,
        limit=WEAK,
    )


@router.post("/sensors/{sensor_id:int}/plan", response_class=HTMLResponse, dependencies=[KNOWN])
async def plan(request: Request, sensor_id: int, stars: Stars) -> Response:
    """Compute the plan, which takes seconds, and show it under its form, or give it as CSV."""
    typed = await read_texts(request)
    try:
        found = await run_in_threadpool(_compute, request, sensor_id, typed, stars)
    except NotFoundError:
        raise
    except BoresightError as error:
        refusal = RefusalContext.of(error)
        return await read_again(request, partial(_page, request, sensor_id, typed, None, refusal))
    if typed.get("format") == "csv":
        headers = {"Content-Disposition": f'attachment; filename="pointings-{sensor_id}.csv"'}
        return Response(found.to_csv(), media_type="text/csv", headers=headers)
    return await read_again(request, partial(_page, request, sensor_id, typed, found, None))


def _compute(
    request: Request, sensor_id: int, typed: Mapping[str, str], stars: Callable[[], Catalogue]
) -> PointingPlan:
    constraints = pointings.read_constraints(typed.get("start_utc", ""), _read_orbit(typed), _read_kept(typed))
    candidates = pointings.read_candidates(pointings.read_candidate_lines(typed.get("candidates", "")))
    criterion = typed.get("criterion") or "A"
    kind, _, text = typed.get("known", "").partition(" ")
    number = parse_row_id(text)
    if criterion not in CRITERIA or (text and (number is None or kind not in {SET, RUN})):
        raise RefusedInputError("The form names no such criterion or calibration; choose one from its lists.")
    server = get_server(request)
    with open_reading(server.engine) as session:
        sensor = session.get_known(Sensor, sensor_id)
        known = pointings.read_known(
            session, server.blobs, sensor, number if kind == RUN else None, number if kind == SET else None
        )
        document = sensor.document
    return pointings.compute(document, known, candidates, constraints, "D" if criterion == "D" else "A", stars)


def _read_kept(typed: Mapping[str, str]) -> dict[str, Any]:
    """Read the constraints; what is left empty is as usual."""
    given: dict[str, Any] = {"minutes": MINUTES}
    whole = {one.name for one in fields(Constraints) if isinstance(one.default, int)}
    for asked in (*TIMES, *ANGLES):
        if text := typed.get(asked.name, "").strip():
            given[asked.name] = (read_whole_number if asked.name in whole else read_number)(asked.label, text)
    return given


def _read_orbit(typed: Mapping[str, str]) -> dict[str, float] | None:
    """Read the orbit; None where none of its numbers is given, which leaves the Earth in nobody's way."""
    given = {name: typed.get(name, "").strip() for name in ORBIT}
    if not any(given.values()):
        return None
    if missing := [ORBIT[name] for name, text in given.items() if not text]:
        raise RefusedInputError(f"The orbit lacks {', '.join(missing)}: give all three of its numbers, or none.")
    return {name: read_number(ORBIT[name], text) for name, text in given.items()}
