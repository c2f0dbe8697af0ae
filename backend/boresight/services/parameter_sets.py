"""Parameter sets: immutable, identified by the SHA-256 of their canonical JSON, one of them a sensor's baseline.

Ground states and who moves them::

    CANDIDATE, WITHDRAWN, SUPERSEDED --submit--> SUBMITTED --sign--> APPROVED --promote--> BASELINE --> SUPERSEDED
    SUBMITTED, APPROVED --withdraw--> WITHDRAWN     SUBMITTED, APPROVED --one refusal--> REJECTED

A set that was baseline once goes back to SUPERSEDED instead of WITHDRAWN or REJECTED. Rollback is a new request for
such a set, signed and promoted like any other. What is on board is another state, in `uplinks`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.estimation.cameras import CAMERA_MODELS
from boresight.services import audit
from boresight.services.actors import Actor, require_role, require_scope, require_user
from boresight.services.staleness import make_others_stale, refuse_moved
from boresight.services.transitions import bound_hashes, move, require_seen, resting_state, subject_of, who_changed
from boresight.services.words import refuse_control_characters
from boresight.store import approvals as approval_rows
from boresight.store import parameter_sets as rows
from boresight.store.blobs import BlobStore
from boresight.store.documents import sha256_of
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import Approval, ParameterSet, Promotion, Run, Sensor
from boresight.telemetry.sensors import Sensor as SensorDescription

SCHEMA = "boresight.parameter-set/1"
USABLE_STATUSES = ("converged", "max_iterations")
MEANING = ("camera_model", "parameters", "sigma", "covariance")  # what an estimate is
EVIDENCE = (
    "method", "variant", "free", "status", "advice", "frames", "stars", "rms_arc_rad", "chi2_per_dof", "alignment", "inputs",
)  # fmt: skip
SUBMITTABLE = ("CANDIDATE", "WITHDRAWN", "SUPERSEDED")


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
    _record_promotion(session, actor, row, None)
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
    result = json.loads(blobs.read(str(run.result_sha256), verify=True))
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


def get_parameter_set(session: Session, parameter_set_id: int) -> ParameterSet:
    """Return a set.

    Raises
    ------
    NotFoundError
        When there is none with this number.
    """
    row = session.get(ParameterSet, parameter_set_id)
    if row is None:
        raise NotFoundError(f"There is no parameter set {parameter_set_id}.")
    return row


def list_parameter_sets(
    session: Session,
    *,
    sensor_id: int | None = None,
    ground_state: str | None = None,
    before_id: int | None = None,
    limit: int = 100,
) -> Sequence[ParameterSet]:
    """Return a page of sets, newest first; the next page starts before the last one's id."""
    return rows.sets(session, sensor_id=sensor_id, ground_state=ground_state, before_id=before_id, limit=limit)


def baseline_of(session: Session, sensor_id: int) -> ParameterSet | None:
    """Return the sensor's baseline."""
    return rows.baseline(session, sensor_id)


def submit(session: Session, actor: Actor, parameter_set_id: int, reason: str, seen_version: int | None) -> Approval:
    """Ask that a set become baseline, binding the hashes of what an approver will be shown.

    Raises
    ------
    ForbiddenError, PreconditionRequiredError, StaleError, ConflictError
        When the actor, the version or the state does not allow it.
    RefusedInputError
        When no reason is given.
    """
    require_role(actor, "analyst")
    require_scope(actor, "parameter-sets")
    user_id = require_user(actor, "submit a parameter set")
    refuse_control_characters(reason=reason)
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    if row.ground_state not in SUBMITTABLE:
        raise ConflictError(f"{row.name} is {row.ground_state}: {who_changed(session, row)}. It cannot be submitted.")
    if not reason.strip():
        raise RefusedInputError("Give the reason why this set should become the baseline.")
    approval = Approval(
        parameter_set_id=row.id,
        state="OPEN",
        reason=reason.strip(),
        submitted_utc=utc_now(),
        submitted_by=user_id,
        bound=bound_hashes(session, row),
    )
    session.add(approval)
    session.flush()
    audit.append(
        session, actor, "opened", subject_of(approval), None, {"set": row.name, "bound": approval.bound}, reason
    )
    move(session, actor, row, "SUBMITTED", "submitted", reason=reason.strip())
    return approval


def withdraw(
    session: Session, actor: Actor, parameter_set_id: int, seen_version: int | None, reason: str = ""
) -> ParameterSet:
    """Take a request back: its submitter, or an administrator.

    Raises
    ------
    ForbiddenError, PreconditionRequiredError, StaleError, ConflictError
        When the actor, the version or the state does not allow it.
    """
    require_scope(actor, "parameter-sets")
    refuse_control_characters(reason=reason)
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = approval_rows.latest_of(session, row.id, "OPEN", "APPROVED")
    if row.ground_state not in {"SUBMITTED", "APPROVED"} or approval is None:
        raise ConflictError(f"{row.name} is {row.ground_state}, not submitted; there is nothing to withdraw.")
    if actor.user_id != approval.submitted_by:
        require_role(actor, "administrator")
    approval.closed_utc = utc_now()
    move(session, actor, approval, "WITHDRAWN", "withdrew", reason=reason.strip() or None)
    move(session, actor, row, resting_state(row, "WITHDRAWN"), "withdrew", reason=reason.strip() or None)
    return row


def promote(session: Session, actor: Actor, parameter_set_id: int, seen_version: int | None) -> ParameterSet:
    """Make an approved set the baseline, supersede the old one and make every other request stale, all in one.

    Raises
    ------
    ForbiddenError, PreconditionRequiredError, ConflictError
        When the actor, the version or the state does not allow it.
    StaleError
        When the version, or what the approval was bound to, has moved; then the request is stale from now on.
    """
    require_role(actor, "operator")
    require_scope(actor, "parameter-sets")
    row = get_parameter_set(session, parameter_set_id)
    require_seen(session, row, seen_version)
    approval = approval_rows.latest_of(session, row.id, "APPROVED")
    if row.ground_state != "APPROVED" or approval is None:
        raise ConflictError(f"{row.name} is {row.ground_state}, not APPROVED: {who_changed(session, row)}.")
    refuse_moved(session, actor, approval, row)
    incumbent = rows.baseline(session, row.sensor_id)
    now = utc_now()
    if incumbent is not None:
        incumbent.baseline_to_utc = now
        move(session, actor, incumbent, "SUPERSEDED", "superseded", reason=f"{row.name} became baseline")
    row.baseline_from_utc, row.baseline_to_utc = now, None
    move(session, actor, row, "BASELINE", "promoted", reason=approval.reason)
    _record_promotion(session, actor, row, approval)
    make_others_stale(session, actor, row)
    return row


def _record_promotion(session: Session, actor: Actor, row: ParameterSet, approval: Approval | None) -> None:
    """Add the promotion to the history that answers what was baseline at a time."""
    session.add(
        Promotion(
            sensor_id=row.sensor_id,
            parameter_set_id=row.id,
            approval_id=None if approval is None else approval.id,
            at_utc=str(row.baseline_from_utc),
            promoted_by=actor.user_id,
        )
    )
    session.flush()
