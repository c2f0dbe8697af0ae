"""The gallery: every figure of the registry and every element of the pages, in all their states, on a specimen.

It is where a person learns what a figure looks like before there is a run, and what the screenshot tests look at. Nothing
here reads the store: the figures draw `boresight.figures.specimen`.
"""

from __future__ import annotations

import csv
import io
from itertools import zip_longest

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse, Response

from boresight.api.credentials import who_acts
from boresight.errors import NotFoundError, RefusedInputError
from boresight.figures import CHAPTERS, FIGURES, WIDE, figure_json
from boresight.figures.parameter_table import parameter_rows
from boresight.figures.specimen import specimen_traces, specimens
from boresight.pages.rendering import render
from boresight.pages.states import LEVEL_OF_STATE
from boresight.verdicts.verdict import LEVELS, marks

PARTS = {"figures": "Figures", "elements": "Elements"}
STATES = {
    "one": ("One run", ("filter",)),
    "two": ("Two runs compared", ("filter", "batch")),
    "partial": ("Half-way", ("partial",)),
    "nothing": ("Nothing yet", ("nothing",)),
}

router = APIRouter(dependencies=[Depends(who_acts)])


def _traces_of(name: str, of: str) -> tuple[str, ...]:
    """Find a figure and a state, or say which there are."""
    if name not in FIGURES:
        raise NotFoundError(f"There is no figure {name}; choose from {', '.join(FIGURES)}.")
    return _state(of)[1]


def _state(of: str) -> tuple[str, tuple[str, ...]]:
    if of not in STATES:
        raise NotFoundError(f"There is no state {of}; choose from {', '.join(STATES)}.")
    return STATES[of]


@router.get("/gallery", response_class=HTMLResponse)
def gallery_page(request: Request, part: str = "figures", of: str = "one") -> HTMLResponse:
    """Show the figures in a state, or the elements."""
    if part not in PARTS:
        raise NotFoundError(f"There is no part {part}; choose from {', '.join(PARTS)}.")
    _state(of)
    result = specimens()["filter"]
    return render(
        request,
        f"administration/gallery_{part}.html",
        part=part,
        parts=PARTS,
        of=of,
        states=STATES,
        chapters=CHAPTERS,
        wide=WIDE,
        levels=LEVELS,
        words=LEVEL_OF_STATE,
        marks=marks(result),
        rows=parameter_rows(result),
    )


@router.get("/gallery/figures/{name}")
def gallery_figure(name: str, of: str = "one") -> Response:
    """Send a figure of the specimen as Plotly JSON."""
    if of == "broken":
        raise RefusedInputError("This figure fails on purpose, to show how its panel says why; Retry asks again.")
    traces = specimen_traces(_traces_of(name, of))
    return Response(figure_json(FIGURES[name].draw(traces)), media_type="application/json")


@router.get("/gallery/figures/{name}/data")
def gallery_data(name: str, of: str = "one") -> Response:
    """Send the numbers of a figure of the specimen as CSV."""
    shown = _traces_of(name, of)
    table = FIGURES[name].table(specimens()[shown[0]])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip_longest(*table.values()))
    return Response(text.getvalue(), media_type="text/csv; charset=utf-8")
