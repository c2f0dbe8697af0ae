"""A parameter set in another camera model: computed when asked for, kept nowhere."""

from __future__ import annotations

from typing import Any

from boresight.calibration.conversion import converted
from boresight.services.parameter_sets import get_parameter_set
from boresight.services.sensors import get_sensor
from boresight.store.sessions import Session
from boresight.telemetry.sensors import parse_sensor


def conversion_of(
    session: Session, parameter_set_id: int, target: str, allowed_px: float | None = None
) -> dict[str, Any]:
    """Write a set in another camera model; parameters and document as in `calibration.conversion.converted`.

    Raises
    ------
    NotFoundError
        When there is no such set.
    RefusedInputError
        When there is no such model, or it cannot follow the set closely enough; says by how much, and why.
    """
    row = get_parameter_set(session, parameter_set_id)
    sensor = parse_sensor(get_sensor(session, row.sensor_id).document)
    return converted(row.document, sensor, row.name, target, allowed_px)
