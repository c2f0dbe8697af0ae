"""Run requests, checked against the sensor, its telemetry and the settings that fit both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from boresight.calibration.options import CalibrationSettings
from boresight.cameras import CAMERA_MODELS
from boresight.console.fleet.tables import Sensor
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.platform.web.text_validation import refuse_control_characters

LABEL_LENGTH = 200


@dataclass(frozen=True)
class RunRequest:
    """What a run is asked to do, checked."""

    sensor: Sensor
    telemetry: TelemetrySet
    validation: TelemetrySet | None
    settings: CalibrationSettings
    label: str

    def columns(self) -> dict[str, Any]:
        """Return the columns of a run's row that are fixed at its launch."""
        return {
            "sensor_id": self.sensor.id,
            "telemetry_set_id": self.telemetry.id,
            "validation_set_id": None if self.validation is None else self.validation.id,
            "method": self.settings.method,
            "settings": self.settings.document(),
            "sensor_document": self.sensor.document,
            "label": self.label,
        }

    def on_record(self) -> dict[str, Any]:
        """Return what the audit log keeps of a launch."""
        return {
            "sensor": self.sensor.name,
            "telemetry_set": self.telemetry.name,
            "settings": self.settings.document(),
        }


def check_run_request(
    session: Session,
    sensor_id: int,
    telemetry_set_id: int,
    settings: Mapping[str, Any],
    validation_set_id: int | None = None,
    label: str = "",
) -> RunRequest:
    """Check the choices of a run against one another."""
    sensor = session.get(Sensor, sensor_id)
    if sensor is None:
        raise NotFoundError(f"There is no sensor {sensor_id}; choose one of the list.")
    telemetry = _get_set(session, sensor, telemetry_set_id)
    validation = None if validation_set_id is None else _get_set(session, sensor, validation_set_id)
    if validation is not None and validation.id == telemetry.id:
        raise RefusedInputError(f"{telemetry.name} cannot validate a calibration made from itself; choose another set.")
    refuse_label(label)
    parsed = CalibrationSettings.parse(settings)
    known = CAMERA_MODELS[sensor.document["camera_model"]].parameter_names
    if strange := [name for name in parsed.free or () if name not in known]:
        raise RefusedInputError(f"{sensor.name} has no parameter {', '.join(strange)}; choose from {', '.join(known)}.")
    return RunRequest(sensor, telemetry, validation, parsed, label.strip())


def refuse_label(label: str) -> None:
    """Refuse a label that is too long or holds control characters."""
    if len(label) > LABEL_LENGTH:
        raise RefusedInputError(f"The label has {len(label)} characters; shorten it to {LABEL_LENGTH}.")
    refuse_control_characters(label=label)


def _get_set(session: Session, sensor: Sensor, set_id: int) -> TelemetrySet:
    """Return a telemetry set that this sensor's runs may use."""
    found = session.get(TelemetrySet, set_id)
    if found is None:
        raise NotFoundError(f"There is no telemetry set {set_id}; choose one of the list.")
    if found.sensor_id != sensor.id:
        raise RefusedInputError(f"{found.name} is telemetry of another sensor; choose a set of {sensor.name}.")
    if found.archived_utc is not None:
        raise ConflictError(f"{found.name} was archived on {found.archived_utc[:10]}; choose a set that is in use.")
    return found
