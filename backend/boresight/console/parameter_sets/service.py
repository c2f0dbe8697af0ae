"""Parameter sets: immutable, identified by the SHA-256 of their canonical JSON, one of them a sensor's baseline.

    CANDIDATE, WITHDRAWN, EXPIRED, SUPERSEDED --submit--> SUBMITTED --sign--> APPROVED --promote--> BASELINE --> SUPERSEDED
    SUBMITTED, APPROVED --withdraw--> WITHDRAWN     SUBMITTED, APPROVED --one refusal--> REJECTED
    SUBMITTED, APPROVED --time is over--> EXPIRED   SUBMITTED, APPROVED --what is bound moved--> CANDIDATE

A set that was baseline once goes back to SUPERSEDED instead. What is on board is another state, in `uplinks`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from boresight.calibration.calibration import Calibration, Trust, parse_calibration, to_plain
from boresight.calibration.conversion import converted
from boresight.calibration.exports import Source, export_document, find_camera_format
from boresight.calibration.parameter_set import parse_parameter_set
from boresight.cameras import CAMERA_MODELS
from boresight.console.approvals.tables import Approval
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as rows
from boresight.console.parameter_sets.tables import ParameterSet, Promotion
from boresight.console.runs.results import read_result, refuse_choice
from boresight.console.runs.tables import Run
from boresight.console.transitions import name_subject
from boresight.errors import ConflictError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.documents import compute_sha256
from boresight.platform.db.sessions import Session, utc_now
from boresight.telemetry.sensors import Sensor as SensorDescription
from boresight.telemetry.sensors import parse_sensor, read_described_camera


def record_promotion(
    session: Session, actor: Actor, row: ParameterSet, approval: Approval | None, reason: str = ""
) -> None:
    """Record a promotion, from which the baseline at any time is known; a ground calibration has no request."""
    session.add(
        Promotion(
            sensor_id=row.sensor_id,
            parameter_set_id=row.id,
            approval_id=None if approval is None else approval.id,
            at_utc=str(row.baseline_from_utc),
            promoted_by=actor.user_id,
            reason=reason or None,
        )
    )
    session.flush()


SCHEMA = "boresight.parameter-set/1"
USABLE_STATUSES = ("converged", "max_iterations")
MEANING = ("camera_model", "parameters", "sigma", "covariance")  # members of a result that belong to the estimate
EVIDENCE = (
    "method", "variant", "free", "status", "advice", "advice_codes", "frames", "stars", "rms_arc_rad", "chi2_per_dof", "alignment",
    "inputs", "sigma_with_misfit", "misfit",
)  # fmt: skip


def create_ground_calibration(
    session: Session, actor: Actor, sensor: Sensor, description: SensorDescription
) -> ParameterSet:
    """Make a sensor's set number 0; its covariance is declared, the typical spread from unit to unit squared."""
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
        "advice": ["Declared, not measured: the typical spread between sensors of this kind is used as the sigma."],
        "advice_codes": ["ground_calibration"],
        "run_id": None,
        "result_sha256": None,
        "inputs": None,
    }
    row = _add(session, actor, sensor, document, ground_state="BASELINE")
    row.baseline_from_utc = row.created_utc
    record_promotion(session, actor, row, None)
    return row


def create_from_run(session: Session, actor: Actor, blobs: BlobStore, run_id: int) -> ParameterSet:
    """Make a candidate from a run's result; for the same run again, return the existing one."""
    require_role(actor, "analyst")
    require_scope(actor, "parameter-sets")
    run = _get_succeeded_run(session, run_id)
    if (existing := rows.find_set_of_run(session, run_id)) is not None:
        return existing
    result = read_result(blobs, str(run.result_sha256), run.id)
    found = parse_calibration(result)
    _refuse_unusable(run_id, found)
    sensor = session.get_one(Sensor, run.sensor_id)
    document = dict.fromkeys((*MEANING, *EVIDENCE))
    document |= {key: value for key, value in result.items() if key in document}  # as it is written there
    document |= _keep_residual_spline(found.trust)
    document |= {"sensor": sensor.name, "run_id": run.id, "result_sha256": run.result_sha256}
    return _add(session, actor, sensor, document, ground_state="CANDIDATE", run_id=run.id)


def _keep_residual_spline(trust: Trust | None) -> dict[str, Any]:
    """Read the residual spline of a result where it is significant, to be stored with the parameters that it belongs to."""
    spline = trust.residual_spline if trust else None
    return {"residual_spline": to_plain(spline)} if spline and spline.structure else {}


def _get_succeeded_run(session: Session, run_id: int) -> Run:
    run = session.get_known(Run, run_id)
    refuse_choice(run)
    if run.state != "SUCCEEDED" or run.result_sha256 is None:
        why = f": {run.reason}" if run.reason else ""
        raise ConflictError(f"Run {run_id} is {run.state}{why}; make a parameter set from a run that SUCCEEDED.")
    return run


def _refuse_unusable(run_id: int, result: Calibration) -> None:
    """Refuse a result that did not converge or has no complete set of finite parameters."""
    if result.status not in USABLE_STATUSES:
        advice = " ".join(result.advice)
        raise RefusedInputError(
            f"Run {run_id} ended {result.status}, so no parameter set can be made from it. {advice}".rstrip()
        )
    names = CAMERA_MODELS[result.camera_model].parameter_names
    known = {name for name, value in result.parameters.items() if value is not None and math.isfinite(value)}
    if bad := [name for name in names if name not in known]:
        raise RefusedInputError(
            f"Run {run_id} has no number for {', '.join(bad)}, so no parameter set can be made from it; calibrate again."
        )


def _add(
    session: Session,
    actor: Actor,
    sensor: Sensor,
    document: Mapping[str, Any],
    *,
    ground_state: str,
    run_id: int | None = None,
) -> ParameterSet:
    number = rows.read_next_number(session, sensor.id)
    model = CAMERA_MODELS[document["camera_model"]]
    units = dict(zip(model.parameter_names, model.units, strict=True))
    body = {**document, "schema": SCHEMA, "name": f"PS-{sensor.name}-{number}", "units": units}
    row = ParameterSet(
        name=body["name"],
        sensor_id=sensor.id,
        number=number,
        run_id=run_id,
        sha256=compute_sha256(body),
        document=body,
        ground_state=ground_state,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.put(row)
    after = {"name": row.name, "ground_state": ground_state, "sha256": row.sha256, "run_id": run_id}
    audit.append(session, actor, "created", name_subject(row), None, after)
    return row


def convert_parameter_set(
    session: Session,
    parameter_set_id: int,
    target: str,
    allowed_px: float | None = None,
    *,
    with_residual: bool = False,
) -> dict[str, Any]:
    """Write a set in another camera model; parameters and document as in `calibration.conversion.converted`."""
    row = session.get_known(ParameterSet, parameter_set_id)
    sensor = parse_sensor(session.get_known(Sensor, row.sensor_id).document)
    return converted(row.document, sensor, row.name, target, allowed_px, with_residual=with_residual)


def export_parameter_set(
    session: Session,
    parameter_set_id: int,
    form: str,
    allowed_px: float | None = None,
    *,
    with_residual: bool = False,
) -> tuple[bytes, str]:
    """Write a set as another program's file, as `calibration.exports` does: its bytes and its name."""
    row = session.get_known(ParameterSet, parameter_set_id)
    found = find_camera_format(form)
    source = Source(row.name, row.sha256, parse_sensor(session.get_known(Sensor, row.sensor_id).document))
    content, _ = export_document(found, row.document, source, residual=with_residual, allowed_px=allowed_px)
    return content, f"{row.name}-{found.name}{found.suffixes[0]}"


def get_incumbent_parameters(session: Session, run: Run) -> dict[str, float | None]:
    """Return the baseline's parameters in SI; none where the run started from them or there is no baseline."""
    baseline = rows.find_baseline(session, run.sensor_id)
    if baseline is None:
        return {}
    parameters = parse_parameter_set(baseline.document).parameters.to_dict()
    initial = read_described_camera(run.sensor_document).initial
    return {} if all(parameters.get(name) == value for name, value in initial.items()) else dict(parameters)
