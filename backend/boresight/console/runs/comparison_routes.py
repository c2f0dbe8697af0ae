"""Runs against a reference run: the numbers, the table as CSV, and the radial difference as a figure."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query
from starlette.requests import Request
from starlette.responses import Response

from boresight.console.access.dependencies import Blobs, Drawings, Reading
from boresight.console.operation import json_response, operations
from boresight.console.runs import comparisons, schemas
from boresight.console.runs.comparisons import Comparison
from boresight.console.runs.figure_routes import get_figure_source, make_label
from boresight.figures import figure_json
from boresight.figures.charts import radial as radial_contrast
from boresight.platform.blobs.folder import BlobStore
from boresight.platform.db.sessions import Session
from boresight.platform.web.media import CsvFile, csv_response

router = operations("/runs", tags=["runs"])

Asked = Annotated[str, Query(alias="runs", description="The runs, 2 to 20: `1,2,3`.", examples=["1,2,3"])]
ReferenceRun = Annotated[
    str, Query(alias="reference", description="The run the others are set against; the first if left out.")
]
CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row a run and item, numbers in SI."}}


@router.get("/compare", summary="Compare runs", response_model=schemas.Comparison)
def compare_runs(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Set runs of one camera model against one of them: parameters in sigmas of the difference, correlations, radial curves.

    `assumption` and each run's `shared_data` say how the sigma of a difference was made from data that runs share.
    """
    return json_response(comparisons.document(_compared(session, blobs, asked, reference)))


@router.get("/compare/data", summary="Read a comparison's table", response_class=CsvFile, responses=CSV)
def compare_runs_data(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Read the comparison of the parameters as CSV: one row a parameter and run."""
    table = comparisons.table(_compared(session, blobs, asked, reference))
    return csv_response(table, f"compare-{_name(asked)}.csv")


@router.get("/compare/figures/radial", summary="Draw radial differences", response_model=schemas.PlotlyFigure)
def draw_radial_contrast(
    session: Reading,
    blobs: Blobs,
    drawings: Drawings,
    request: Request,
    asked: Asked,
    reference: ReferenceRun = "",
) -> Response:
    """Draw how far each run places stars along the radius from where the reference places them, as Plotly JSON."""
    runs = comparisons.read_runs(session, comparisons.read_run_ids([asked]))
    labels, sources = [make_label(session, run) for run in runs], [get_figure_source(session, run) for run in runs]

    def draw() -> bytes:
        found = _compared(session, blobs, asked, reference)
        return figure_json(radial_contrast.draw_radial_contrast(labels, found.reference, found.radial()))

    known = None if None in sources else ["radial contrast", reference, *labels, *map(str, sources)]
    return drawings.answer(request, known, draw)


@router.get("/compare/figures/radial/data", summary="Read radial differences", response_class=CsvFile, responses=CSV)
def get_radial_contrast_data(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Read the radial differences to the reference as CSV."""
    found = _compared(session, blobs, asked, reference)
    table = radial_contrast.table_radial_contrast([one.run.id for one in found.compared], found.radial())
    return csv_response(table, f"compare-{_name(asked)}-radial.csv")


def _compared(session: Session, blobs: BlobStore, asked: str, reference: str) -> Comparison:
    """Compare the runs that the address names."""
    chosen = comparisons.read_run_ids([reference]) if reference else []
    run_ids = comparisons.read_run_ids([asked])
    return comparisons.compare(session, blobs, run_ids, chosen[0] if chosen else None)


def _name(asked: str) -> str:
    """Name the runs in a file's name."""
    return "-".join(map(str, comparisons.read_run_ids([asked])))
