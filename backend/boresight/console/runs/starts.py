"""Where a run starts from: an earlier calibration with its covariance; what makes no sense is refused before it is queued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from boresight.calibration.calibration import USABLE
from boresight.calibration.joint.prior import refuse_cosine, refuse_vary, refuse_without_prior
from boresight.calibration.joint.variation import check_variation, refuse_one_pass
from boresight.calibration.options import CalibrationSettings
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import queries
from boresight.console.runs.results import refuse_choice
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.telemetry.sensors import parse_sensor, read_described_camera
from boresight.verdicts.verdict import parse_run_summary

#: States in which a parameter set may be started from.
TRUSTED = ("APPROVED", "BASELINE", "SUPERSEDED")


@dataclass(frozen=True)
class Start:
    """The calibration that a run starts from, the parameter set it was named by, and the telemetry sets that it holds."""

    run: Run
    named: ParameterSet | None
    held: frozenset[int]

    @property
    def name(self) -> str:
        """What refusals and results call it."""
        return f"run {self.run.id}" if self.named is None else self.named.name


def find_start(session: Session, sensor: Sensor, prior_run_id: int | None, prior_set_id: int | None) -> Start | None:
    """Return the calibration that a run of this sensor starts from, named as a run or as a parameter set; None where none is."""
    if prior_run_id is not None and prior_set_id is not None:
        raise RefusedInputError("A run starts from one calibration: name a run or a parameter set, not both.")
    named = None if prior_set_id is None else _get_trusted_set(session, sensor, prior_set_id)
    if named is not None:
        prior_run_id = named.run_id
    if prior_run_id is None:
        return None
    run = session.get_known(Run, prior_run_id)
    refuse_choice(run)
    name = f"Run {run.id}" if named is None else named.name
    if run.sensor_id != sensor.id:
        raise RefusedInputError(f"{name} is of another sensor; choose a calibration of {sensor.name}.")
    if named is None and queries.find_archived(session, run.id) is not None:
        raise ConflictError(f"{name} is archived; show it again, or start from another calibration.")
    if run.state != "SUCCEEDED" or run.result_sha256 is None:
        raise ConflictError(
            f"{name} is {run.state} and has no result; start from a run that SUCCEEDED.", code="no-result"
        )
    if (status := parse_run_summary(run.summary).status) != USABLE:
        ended = (status or "without an estimate").replace("_", " ")
        raise RefusedInputError(
            f"{name} ended {ended}, so its result is not reliable; start from one that converged.", code="not-converged"
        )
    return Start(run, named, frozenset(queries.list_held_sets(session, run)))


def is_trusted(row: ParameterSet) -> bool:
    """Whether a run may start from a parameter set: estimated, and approved or on board."""
    return row.run_id is not None and (row.ground_state in TRUSTED or row.onboard_state == "ACTIVE")


def _get_trusted_set(session: Session, sensor: Sensor, set_id: int) -> ParameterSet:
    """Return a parameter set that a run may start from."""
    found = session.get_known(ParameterSet, set_id)
    if found.sensor_id != sensor.id:
        raise RefusedInputError(f"{found.name} is of another sensor; choose a parameter set of {sensor.name}.")
    if found.run_id is None:
        raise RefusedInputError(
            f"{found.name} is the ground calibration, whose covariance was declared and not measured; choose a set made from a run."
        )
    if not is_trusted(found):
        raise ConflictError(
            f"{found.name} is {found.ground_state}; start from an approved set, or name run {found.run_id} itself."
        )
    return found


def check_start(
    sensor: Sensor,
    sets: Sequence[TelemetrySet],
    validation: TelemetrySet | None,
    settings: CalibrationSettings,
    start: Start | None,
) -> None:
    """Refuse what a run of these sets cannot make of its prior, or of parameters that vary from set to set."""
    free = list(settings.free or read_described_camera(sensor.document).free)
    if settings.vary and len(sets) < 2:
        refuse_one_pass()
    if settings.vary:
        check_variation(free, settings)
    if start is None:
        refuse_without_prior(settings)
        return
    refuse_vary(settings)
    refuse_cosine(settings)
    _check_same_parameters(sensor, free, start)
    if validation is not None and validation.id in start.held:
        raise RefusedInputError(
            f"{validation.name} took part in {start.name}; choose a validation set that did not.",
            code="prior-holds-validation",
        )
    if all(one.id in start.held for one in sets):
        raise RefusedInputError(
            f"{start.name} already contains {', '.join(one.name for one in sets)}, and stars must not be counted twice; choose "
            "newer telemetry, or start from another calibration.",
            code="prior-holds-telemetry",
        )


def _check_same_parameters(sensor: Sensor, free: Sequence[str], start: Start) -> None:
    """Refuse a calibration of another camera model, or of other free parameters."""
    before, now = parse_sensor(start.run.sensor_document), read_described_camera(sensor.document)
    if before.camera_model != now.camera_model:
        raise RefusedInputError(
            f"{start.name} is of the camera model {before.camera_model}, and {sensor.name} has "
            f"{now.camera_model} now; start from a calibration of that model.",
            code="other-camera-model",
        )
    known = list(start.run.stated_settings.free or before.free)
    if sorted(free) != sorted(known):
        raise RefusedInputError(
            f"{start.name} estimated {', '.join(known)}, but this run frees {', '.join(free)}; free the same parameters, because "
            "its covariance is valid only with these."
        )
