"""A sensor over the mission: whether to recalibrate, whether it drifts, every parameter over time, and why what counts.

One figure for the baseline's camera model, and one for each other model that was calibrated: they are not to be compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from boresight.api.dependencies import Reading, Who
from boresight.figures import trend as figure
from boresight.pages.rendering import render
from boresight.services import alarms, sensors
from boresight.services.trend_views import trend_document

router = APIRouter()

LEVEL_OF_ANSWER = {"YES": "caution", "NOT YET": "normal", "MORE DATA NEEDED": "standby"}
LEVEL_OF_DRIFT = {"DRIFT": "serious", "GROUND SHIFT": "caution", "HOLDS": "normal", "NOT TESTED": "off"}


@router.get("/sensors/{sensor_id:int}/trend", response_class=HTMLResponse)
def trend_page(request: Request, session: Reading, actor: Who, sensor_id: int) -> HTMLResponse:  # noqa: ARG001 - whoever is known may read
    """Show a sensor over the mission."""
    document = trend_document(session, sensor_id)
    return render(
        request,
        "fleet/trend.html",
        sensor=sensors.get_sensor(session, sensor_id),
        trend=document,
        models=[None, *dict.fromkeys(point["camera_model"] for point in document["others"])],
        figure=figure,
        rows=_rows(document),
        points=[*document["points"], *document["others"]][::-1],
        open_alarms=alarms.list_alarms(session, alarms.Sought(sensor_id=sensor_id)),
        answer_level=LEVEL_OF_ANSWER[document["advice"]["answer"]],
        drift_level=LEVEL_OF_DRIFT[document["drift"]["verdict"]],
    )


def _rows(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Return the drift of each tested parameter: the change with its sigma, and the slope with its own."""
    drift = document["drift"]
    if not drift["names"]:
        return []
    slope, sigma = drift["slope_per_day"] or {}, drift["slope_sigma_per_day"] or {}
    return [
        {
            "name": name,
            "difference": drift["difference"][name],
            "sigma": drift["sigma"][name],
            "worth": drift["difference"][name] / drift["sigma"][name],
            "slope": slope.get(name),
            "slope_sigma": sigma.get(name),
        }
        for name in drift["names"]
    ]
