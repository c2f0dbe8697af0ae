"""A sensor's trend as one JSON document, SI: what the REST interface gives and `figures.trend` draws."""

from __future__ import annotations

from typing import Any

from boresight.estimation.cameras import CAMERA_MODELS
from boresight.services import drift as drifts
from boresight.services.advice import Advice, advise
from boresight.services.drift import Drift, judge
from boresight.services.trend import Period, Point, Trend, trend_of
from boresight.store.sessions import Session

SCHEMA = "boresight.trend/1"


def trend_document(session: Session, sensor_id: int) -> dict[str, Any]:
    """Return a sensor over the mission, with the drift tests and the advice.

    Raises
    ------
    NotFoundError
        When there is no such sensor.
    """
    trend = trend_of(session, sensor_id)
    found = judge(trend)
    return document_of(trend, found, advise(trend, found))


def document_of(trend: Trend, found: Drift, advice: Advice) -> dict[str, Any]:
    """Write a trend."""
    baseline = trend.baseline
    return {
        "schema": SCHEMA,
        "sensor_id": trend.sensor.id,
        "sensor": trend.sensor.name,
        "camera_model": trend.camera_model,
        "parameter_names": list(CAMERA_MODELS[trend.camera_model].parameter_names),
        "baseline": None if baseline is None else {"parameter_set_id": baseline.id, "name": baseline.name},
        "points": [_point(point) for point in trend.points],
        "others": [_point(point) for point in trend.others],
        "baselines": [_period(period) for period in trend.periods],
        "on_board": [
            {"at_utc": mark.at_utc, "state": mark.state, "parameter_set_id": mark.set_id, "name": mark.name}
            for mark in trend.marks
        ],
        "truth": trend.sensor.truth,
        "drift": drifts.document(found),
        "advice": {"answer": advice.answer, "sentence": advice.sentence, "reasons": list(advice.reasons)},
    }


def _point(point: Point) -> dict[str, Any]:
    """Write a calibration."""
    return {
        "run_id": point.run_id,
        "label": point.label,
        "method": point.method,
        "camera_model": point.camera_model,
        "telemetry_set_id": point.telemetry_set_id,
        "telemetry": point.telemetry,
        "begins_utc": point.begins_utc,
        "at_utc": point.at_utc,
        "ends_utc": point.ends_utc,
        "timed": point.timed,
        "temperature_c": point.temperature_c,
        "parameters": {name: point.parameters[name] for name in point.names},
        "sigma": point.sigma,
        "stars": point.stars,
        "rms_arc_rad": point.rms_arc_rad,
        "counted": not point.left_out,
        "left_out": point.left_out or None,
        "said": point.said or None,
    }


def _period(period: Period) -> dict[str, Any]:
    """Write a baseline's time."""
    return {
        "parameter_set_id": period.set_id,
        "name": period.name,
        "from_utc": period.from_utc,
        "to_utc": period.to_utc,
        "measured": period.measured,
        "parameters": dict(period.parameters),
        "sigma": dict(period.sigma),
    }
