"""Figures of one run or several, as Plotly JSON and as the numbers behind them, thinned so that no peak is lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import orjson
from fastapi import Depends, Path, Query
from starlette.requests import Request
from starlette.responses import Response

from boresight.calibration.calibration import Calibration
from boresight.console.access.dependencies import Blobs, Reading, ServerFigureCache
from boresight.console.fleet.tables import Sensor
from boresight.console.operation import RowWithFields, json_response, operations
from boresight.console.parameter_sets.service import get_incumbent_parameters
from boresight.console.runs import comparisons, schemas
from boresight.console.runs import service as runs
from boresight.console.runs.comparisons import Comparison
from boresight.console.runs.service import find_calibration
from boresight.console.runs.tables import Run, parse_progress
from boresight.errors import NotFoundError, RefusedInputError
from boresight.figures import FIGURES, Figure, Table, Trace, figure_json
from boresight.figures.chart import labelled, tailed
from boresight.figures.charts import radial as radial_contrast
from boresight.figures.live_traces import tell_place
from boresight.figures.style.thinning import thinning
from boresight.figures.views import aligned, as_band, focus
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session
from boresight.platform.web.media import CsvFile, csv_response
from boresight.platform.web.paging import Id, Listing, Page

comparison_router = operations("/runs", tags=["runs"])  # before the others, which would take `compare` for a number
router = operations("/runs", tags=["runs"])

MOST_OVERLAID = 20
FigureName = Annotated[str, Path(description=f"One of {', '.join(FIGURES)}.")]
Heard = tuple[int | None, str | None]  # how many frames the first run has, and when it was last heard of
Compare = Annotated[str, Query(description="Other runs to show with it: `2,3`.", examples=["2,3"])]


@dataclass(frozen=True)
class FigureView:
    """How runs are overlaid in a figure, and which part of the axis is shown."""

    align: Annotated[
        Literal["frame", "time", "update"],
        Query(description="Unit of the frame axis: frames, hours since each run's first frame, or updates."),
    ] = "frame"
    overlay: Annotated[
        Literal["lines", "band"],
        Query(description="Draw every run, or the first and the span from the lowest to the highest of the others."),
    ] = "lines"
    x_from: Annotated[float | None, Query(description="Start of the part of the x axis that is shown in full.")] = None
    x_to: Annotated[float | None, Query(description="End of the part of the x axis that is shown in full.")] = None
    tail_from: Annotated[
        float | None, Query(description="Where the tail of the RMS begins; by default where the run settled.")
    ] = None

    size: Annotated[
        Literal["large", "medium", "narrow", "small"],
        Query(
            description="Draw the figure of a page, the same for half of one or for a phone, or a result's small view."
        ),
    ] = "large"

    def draw(self, figure: Figure, traces: list[Trace], heard: Heard) -> bytes:
        """Draw a figure in this view; of a running run it says as of which frame it is."""
        if (self.x_from is None) != (self.x_to is None):
            raise RefusedInputError("Give both ends of the window, x_from and x_to, or neither.")
        with thinning(whole=self.x_from is not None) as watched:
            traces = labelled(traces, self.size)
            drawn = figure.draw_for(self.size, tailed(aligned(traces, self.align), self.tail_from))
            if drawn is None:
                raise RefusedInputError(f"There is no small figure {figure.name}; ask for the large one.")
        tell_place(drawn, traces, *heard)
        if self.overlay == "band":
            as_band(drawn, traces)
        if self.x_from is not None and self.x_to is not None:
            focus(drawn, self.x_from, self.x_to)
        if watched.too_long:
            drawn.layout.meta = {**(drawn.layout.meta or {}), "detail": True}
        return figure_json(drawn)


Seen = Annotated[FigureView, Depends()]


@router.get("/{run_id}/figures", summary="List the figures", response_model=Page[schemas.FigureEntry])
def list_figures(run_id: Id, session: Reading) -> Listing[RowWithFields]:
    """List the figures of a run with how to read each."""
    runs.get_run(session, run_id)
    return Listing([RowWithFields(one, href=f"/api/v1/runs/{run_id}/figures/{name}") for name, one in FIGURES.items()])


@router.get("/{run_id}/figures/{name}", summary="Read a figure", response_model=schemas.PlotlyFigure)
def get_figure(
    run_id: Id,
    name: FigureName,
    session: Reading,
    blobs: Blobs,
    figure_cache: ServerFigureCache,
    request: Request,
    seen: Seen,
    compare: Compare = "",
) -> Response:
    """Read a figure as Plotly JSON, of one run or of several overlaid."""
    figure, ids = _figure(name), [run_id, *_others(compare, run_id)]
    asked = comparisons.read_runs(session, ids)
    labels, sources = [make_label(session, run) for run in asked], [get_figure_source(session, run) for run in asked]

    def draw() -> bytes:
        named = zip(labels, asked, strict=True)
        heard = runs.frames_to_come(session, asked[0]), parse_progress(asked[0].progress).at_utc
        return seen.draw(figure, [_make_trace(session, blobs, run, label) for label, run in named], heard)

    known = None if None in sources else [name, repr(seen), *labels, *map(str, sources)]
    return figure_cache.answer(request, known, draw)


def get_figure_source(session: Session, run: Run) -> str | None:
    """Return a text that identifies the data behind a run's figures; None while they may change."""
    if run.result_sha256 is None:
        return None
    moving = [session.get_known(Sensor, run.sensor_id).truth, get_incumbent_parameters(session, run)]
    return run.result_sha256 + orjson.dumps(moving, option=orjson.OPT_SORT_KEYS).decode()


def _make_trace(session: Session, blobs: BlobStore, run: Run, label: str) -> Trace:
    """Read a result, with the parameters that are in force now where the run did not start from them."""
    found, baseline = _read_calibration(session, blobs, run.id), get_incumbent_parameters(session, run)
    return Trace(label, found, f"Run {run.id}", baseline=baseline)


def _read_calibration(session: Session, blobs: BlobStore, run_id: Id) -> Calibration:
    """Read a run's calibration, complete or partial; an empty one where there is none yet."""
    return find_calibration(session, blobs, run_id) or Calibration(status="running")


@router.get(
    "/{run_id}/figures/{name}/data",
    summary="Read a figure's numbers",
    response_class=CsvFile,
    responses={200: {"description": "The columns in SI, never thinned."}},
)
def get_figure_data(run_id: Id, name: FigureName, session: Reading, blobs: Blobs, compare: Compare = "") -> Response:
    """Read the numbers behind a figure as CSV; of several runs one after another, with the run's number first."""
    figure, ids = _figure(name), [run_id, *_others(compare, run_id)]
    tables = {number: figure.table(_read_calibration(session, blobs, number)) for number in ids}
    table = _stacked(tables) if len(tables) > 1 else tables[run_id]
    return csv_response(table, f"run-{'-'.join(map(str, ids))}-{name}.csv")


def _figure(name: str) -> Figure:
    if name not in FIGURES:
        raise NotFoundError(f"There is no figure {name}; choose from {', '.join(FIGURES)}.")
    return FIGURES[name]


def _others(text: str, run_id: Id) -> list[int]:
    """Read the ids of the runs to overlay, each once."""
    if text.count(",") >= MOST_OVERLAID:
        raise RefusedInputError(f"Write the runs to compare as 2,3 and so on, {MOST_OVERLAID - 1} at most.")
    return [number for number in comparisons.read_run_ids([text]) if number != run_id]


def make_label(session: Session, run: Run) -> str:
    """Name a run in a legend."""
    return f"Run {run.id} · {run.own_label or session.get_known(Sensor, run.sensor_id).name}"


def _stacked(tables: Mapping[int, Table]) -> Table:
    """Concatenate the tables of several runs, with the run's number as first column; a column that a run lacks is empty."""
    lengths = {number: max((len(column) for column in table.values()), default=0) for number, table in tables.items()}
    names = dict.fromkeys(name for table in tables.values() for name in table)
    stacked: Table = {"run": [number for number, length in lengths.items() for _ in range(length)]}
    for name in names:
        padded = (table.get(name, []) + [None] * (lengths[k] - len(table.get(name, []))) for k, table in tables.items())
        stacked[name] = [value for column in padded for value in column]
    return stacked


Asked = Annotated[str, Query(alias="runs", description="The runs, 2 to 20: `1,2,3`.", examples=["1,2,3"])]
ReferenceRun = Annotated[
    str, Query(alias="reference", description="The run that the others are compared with; the first if left out.")
]
CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row per run and item, numbers in SI."}}


@comparison_router.get("/compare", summary="Compare runs", response_model=schemas.Comparison)
def compare_runs(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Compare runs of one camera model with one of them: parameters in sigmas of the difference, correlations, radial curves.

    `assumption` and each run's `shared_data` say how the sigma of a difference was made from data that runs share.
    """
    return json_response(comparisons.document(_compared(session, blobs, asked, reference)))


@comparison_router.get("/compare/data", summary="Read a comparison's table", response_class=CsvFile, responses=CSV)
def compare_runs_data(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Read the comparison of the parameters as CSV: one row per parameter and run."""
    table = comparisons.table(_compared(session, blobs, asked, reference))
    return csv_response(table, f"compare-{_name(asked)}.csv")


@comparison_router.get(
    "/compare/figures/radial", summary="Draw radial differences", response_model=schemas.PlotlyFigure
)
def draw_radial_contrast(
    session: Reading,
    blobs: Blobs,
    figure_cache: ServerFigureCache,
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
    return figure_cache.answer(request, known, draw)


@comparison_router.get(
    "/compare/figures/radial/data", summary="Read radial differences", response_class=CsvFile, responses=CSV
)
def get_radial_contrast_data(session: Reading, blobs: Blobs, asked: Asked, reference: ReferenceRun = "") -> Response:
    """Read the radial differences to the reference as CSV."""
    found = _compared(session, blobs, asked, reference)
    table = radial_contrast.table_radial_contrast([one.run.id for one in found.compared], found.radial())
    return csv_response(table, f"compare-{_name(asked)}-radial.csv")


def _compared(session: Session, blobs: BlobStore, asked: str, reference: str) -> Comparison:
    chosen = comparisons.read_run_ids([reference]) if reference else []
    run_ids = comparisons.read_run_ids([asked])
    return comparisons.compare(session, blobs, run_ids, chosen[0] if chosen else None)


def _name(asked: str) -> str:
    return "-".join(map(str, comparisons.read_run_ids([asked])))
