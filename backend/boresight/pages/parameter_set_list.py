"""The list of parameter sets: what each is on the ground and on board, its gates and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.credentials import who_acts
from boresight.api.dependencies import Reading
from boresight.api.keeping import same_for_roles
from boresight.pages.rendering import render
from boresight.pages.runs import Names, read_names
from boresight.pages.sensor_choices import choices_of
from boresight.pages.tables import Column, Table, View, all_of, csv_of, is_number, is_text, one_of, page_of, read_view
from boresight.services import gates
from boresight.store.sessions import Session
from boresight.store.tables import GROUND_STATES, ONBOARD_STATES, ParameterSet

READ_AT_ONCE = 500
SETS = Table(
    "parameter-sets",
    "Parameter sets",
    (
        Column("set", "Set, of sensor", "-set", "named", head=True),
        Column("ground", "Ground", "ground"),
        Column("board", "On board", "board"),
        Column("gates", "Gates", "", "verdict-words"),
        Column("run", "From run", "-run"),
        Column("hash", "SHA-256"),
        Column("by", "Made by", "by", "named"),
        Column("baseline", "Baseline since", "-baseline"),
    ),
    {
        "sensor": is_number,
        "sensor_name": is_text,
        "state": one_of(GROUND_STATES),
        "board": one_of(ONBOARD_STATES),
        "q": is_text,
    },
    "-set",
    kind="sets",
)
CSV_FIELDS = {
    "set": ("number", "set", "sensor"),
    "ground": ("ground_state",),
    "board": ("onboard_state",),
    "gates": ("verdict",),
    "run": ("run",),
    "hash": ("sha256",),
    "by": ("created_by", "created_utc"),
    "baseline": ("baseline_from_utc", "baseline_to_utc"),
}

router = APIRouter(dependencies=[Depends(who_acts)])


@router.get("/parameter-sets", response_class=HTMLResponse, dependencies=[Depends(same_for_roles)])
def parameter_sets_page(request: Request, session: Reading) -> HTMLResponse:
    """Show a page of sets."""
    view = read_view(request, SETS)
    found = page_of(session, view)
    return render(
        request,
        "parameter_sets/parameter_sets.html",
        view=view,
        sets=found.rows,
        last=found.last,
        names=read_names(session, sensors_of=found.rows),
        choices=choices_of(session, view),
        states=GROUND_STATES,
        on_board=ONBOARD_STATES,
        verdicts=gates.verdicts(session, {row.id for row in found.rows}),
    )


@router.get("/parameter-sets.csv")
def parameter_sets_csv(request: Request, session: Reading) -> Response:
    """Give every set of a view as CSV."""
    view = read_view(request, SETS)
    return csv_of(view, CSV_FIELDS, _csv_rows(session, view, read_names(session, sensors_of=None)))


def _csv_rows(session: Session, view: View, names: Names) -> Iterator[dict[str, Any]]:
    """Lay out the sets of a view for a program; the verdicts of many are read at once."""
    rows = iter(all_of(session, view))
    while some := list(islice(rows, READ_AT_ONCE)):
        verdicts = gates.verdicts(session, {row.id for row in some})
        yield from (_csv_row(row, names) | {"verdict": verdicts.get(row.id)} for row in some)


def _csv_row(row: ParameterSet, names: Names) -> dict[str, Any]:
    """Lay out a set for a program."""
    return {
        "number": row.id,
        "set": row.name,
        "sensor": names.sensors[row.sensor_id],
        "ground_state": row.ground_state,
        "onboard_state": row.onboard_state,
        "run": row.run_id,
        "sha256": row.sha256,
        "created_by": names.person(row.created_by),
        "created_utc": row.created_utc,
        "baseline_from_utc": row.baseline_from_utc,
        "baseline_to_utc": row.baseline_to_utc,
    }
