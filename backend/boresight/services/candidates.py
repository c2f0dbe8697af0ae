"""Making a parameter set: the ground calibration of a new sensor, and a candidate of a run's result.

A set is immutable and identified by the SHA-256 of its canonical JSON; its name and units stand inside that document.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope
from boresight.services.calibration_document import read_result
from boresight.services.promotions import record_promotion
from boresight.services.transitions import subject_of
from boresight.store import parameter_sets as rows
from boresight.store.blobs import BlobStore
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import ParameterSet, Run, Sensor
from boresight.telemetry.sensors import Sensor as SensorDescription

SCHEMA = "boresight.parameter-set/1"
USABLE_STATUSES = ("converged", "max_iterations")
MEANING = ("camera_model", "parameters", "sigma", "covariance")  # what an estimate is
EVIDENCE = (
    "method", "variant", "free", "status", "advice", "frames", "stars", "rms_arc_rad", "chi2_per_dof", "alignment", "inputs",
)  # fmt: skip


def create_ground_calibration(
    session: Session, actor: Actor, sensor: Sensor, description: SensorDescription
) -> ParameterSet:
    """Make a new sensor's set number 0, the baseline that every calibration is compared with.

    Nobody measured its covariance: it is declared as the typical spread from unit to unit, squared, on the diagonal.
    """
    names = CAMERA_MODELS[description.camera_model].parameter_names
    sigma = [float(value) for value in description.typical_sigma]
    document = {
        "sensor": sensor.name,
        "camera_model": description.camera_model,
        "parameters": dict(zip(names, map(float, description.initial), strict=True)),
        "sigma": dict(zip(names, sigma, strict=True)),
        "covariance": {
            "names": list(names),
            "matrix": [[s * s if i == j else 0.0 for j in range(len(sigma))] for i, s in enumerate(sigma)],
        },
        "method": None,
        "status": "ground calibration",
        "advice": ["Declared, not measured: the typical spread from unit to unit stands for the sigma."],
        "run_id": None,
        "result_sha256": None,
        "inputs": None,
    }
    row = _add(session, actor, sensor, document, ground_state="BASELINE")
    row.baseline_from_utc = row.created_utc
    record_promotion(session, actor, row, None)
    return row


def create_from_run(session: Session, actor: Actor, blobs: BlobStore, run_id: int) -> ParameterSet:
    """Make a candidate from a run's result; asked again for the same run, return the one that is there.

    Raises
    ------
    NotFoundError
        When there is no such run.
    ConflictError
        When the run did not succeed.
    RefusedInputError
        When its result is no calibration that could be used on board, with the advice that the run gave.
    """
    require_role(actor, "analyst")
    require_scope(actor, "parameter-sets")
    run = _succeeded_run(session, run_id)
    if (existing := rows.set_of_run(session, run_id)) is not None:
        return existing
    result = read_result(blobs, str(run.result_sha256), run.id)
    _refuse_unusable(run_id, result)
    sensor = session.get_one(Sensor, run.sensor_id)
    document = {key: result.get(key) for key in (*MEANING, *EVIDENCE)}
    document |= {"sensor": sensor.name, "run_id": run.id, "result_sha256": run.result_sha256}
    return _add(session, actor, sensor, document, ground_state="CANDIDATE", run_id=run.id)


def _succeeded_run(session: Session, run_id: int) -> Run:
    """Return a run that has a result."""
    run = session.get(Run, run_id)
    if run is None:
        raise NotFoundError(f"There is no run {run_id}.")
    if run.state != "SUCCEEDED" or run.result_sha256 is None:
        why = f": {run.reason}" if run.reason else ""
        raise ConflictError(f"Run {run_id} is {run.state}{why}; a parameter set is made of a run that SUCCEEDED.")
    return run


def _refuse_unusable(run_id: int, result: Mapping[str, Any]) -> None:
    """Refuse a result that did not come to rest or has no complete set of finite parameters."""
    if result.get("status") not in USABLE_STATUSES:
        advice = " ".join(result.get("advice") or ())
        raise RefusedInputError(
            f"Run {run_id} ended {result.get('status')}, which makes no parameter set. {advice}".rstrip()
        )
    parameters = result.get("parameters") or {}
    names = CAMERA_MODELS[result["camera_model"]].parameter_names
    bad = [name for name in names if not _is_finite(parameters.get(name))]
    if bad:
        raise RefusedInputError(f"Run {run_id} has no number for {', '.join(bad)}, which makes no parameter set.")


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _add(
    session: Session,
    actor: Actor,
    sensor: Sensor,
    document: Mapping[str, Any],
    *,
    ground_state: str,
    run_id: int | None = None,
) -> ParameterSet:
    """Store a set under the sensor's next number, its name and units inside the hashed document."""
    number = rows.next_number(session, sensor.id)
    model = CAMERA_MODELS[document["camera_model"]]
    units = dict(zip(model.parameter_names, model.units, strict=True))
    body = {**document, "schema": SCHEMA, "name": f"PS-{sensor.name}-{number}", "units": units}
    row = ParameterSet(
        name=body["name"],
        sensor_id=sensor.id,
        number=number,
        run_id=run_id,
        sha256=sha256_of(body),
        document=body,
        ground_state=ground_state,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.add(row)
    session.flush()
    after = {"name": row.name, "ground_state": ground_state, "sha256": row.sha256, "run_id": run_id}
    audit.append(session, actor, "created", subject_of(row), None, after)
    return row
