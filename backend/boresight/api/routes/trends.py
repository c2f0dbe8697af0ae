"""A sensor over the mission: every calibration at the time of its data, the drift test and the advice; figure and CSV."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query
from starlette.responses import Response

from boresight.api import schemas
from boresight.api.comma_separated import csv_response
from boresight.api.dependencies import Reading
from boresight.api.media import CsvFile
from boresight.api.numbers import Id
from boresight.api.operation import json_response, operations
from boresight.errors import RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.figures import figure_json, trend
from boresight.services.trend_views import trend_document

router = operations("/sensors/{sensor_id}/trend", tags=["sensors"])

MODELS = ", ".join(CAMERA_MODELS)
Model = Annotated[str | None, Query(description=f"A camera model; the baseline's when left out. One of {MODELS}.")]
IN_CSV: dict[int | str, dict[str, Any]] = {200: {"description": "One row a calibration, numbers in SI."}}


def _known(model: str | None) -> str | None:
    """Refuse a camera model that does not exist."""
    if model is not None and model not in CAMERA_MODELS:
        raise RefusedInputError(f"There is no camera model {model!r}; choose from {MODELS}.")
    return model


@router.get("", summary="A sensor over the mission", response_model=schemas.Trend)
def get_sensor_trend(sensor_id: Id, session: Reading) -> Response:
    """Read every calibration at the time of its data, with the baselines and the records on board.

    `drift` says whether the baseline still holds, at 0.1 % false alarms for each look, and whether the parameters move with
    time; `advice` whether to recalibrate now. What takes no part in the tests says why in `left_out`.
    """
    return json_response(trend_document(session, sensor_id))


@router.get("/figure", summary="Read its figure", response_model=schemas.PlotlyFigure)
def get_sensor_trend_figure(sensor_id: Id, session: Reading, model: Model = None) -> Response:
    """Read the trend as Plotly JSON."""
    document = trend_document(session, sensor_id)
    return Response(figure_json(trend.draw(document, _known(model))), media_type="application/json")


@router.get("/data", summary="Read its numbers", response_class=CsvFile, responses=IN_CSV)
def get_sensor_trend_data(sensor_id: Id, session: Reading, model: Model = None) -> Response:
    """Read the numbers behind the figure as CSV."""
    return csv_response(trend.table(trend_document(session, sensor_id), _known(model)), f"sensor-{sensor_id}-trend.csv")
