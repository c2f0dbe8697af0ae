"""Choosing a camera for a run's data: a run of its own, that workers compute as any other, and its answer.

A run that has ended has at most one choice on its way or done: asked again, it is the same one. One that failed, was lost or
cancelled, or whose answer cannot be read any more, is made again.
"""

from __future__ import annotations

from boresight.calibration.choice.result import Choice
from boresight.calibration.options import CalibrationSettings
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import queries
from boresight.console.runs.results import read_choice
from boresight.console.runs.service import get_run
from boresight.console.runs.tables import CHOICE, TERMINAL_RUN_STATES, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.errors import ConflictError, NotFoundError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session

#: The settings of a run that its choice takes over; what is free, and how it was estimated, are the question.
KEPT_SETTINGS = ("match", "minimum_stars")


def request_choice(session: Session, actor: Actor, blobs: BlobStore, run_id: int) -> Run:
    """Queue the choice of a camera for the data of a run that has ended, with its sensor as it was at launch."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    run = get_run(session, run_id)
    known = find_choice_run(session, run_id)
    if known is not None and (known.state not in TERMINAL_RUN_STATES or _is_answered(blobs, known)):
        return known
    if (why := find_obstacle(session, run)) is not None:
        raise ConflictError(why, code="no-choice-possible")
    settings = CalibrationSettings.parse({name: run.settings[name] for name in KEPT_SETTINGS if name in run.settings})
    asked = queries.add_run(
        session,
        sensor_id=run.sensor_id,
        telemetry_set_id=run.telemetry_set_id,
        joint_set_ids=run.joint_set_ids,
        validation_set_id=run.validation_set_id,
        method=CHOICE,
        settings=settings.document(),
        sensor_document=run.sensor_document,
        label=run.label,
        launched_by=actor.user_id,
        choice_of=run.id,
    )
    on_record = {
        "sensor": session.get_known(Sensor, run.sensor_id).name,
        "telemetry_set": session.get_known(TelemetrySet, run.telemetry_set_id).name,
        "choice_of": run.id,
    }
    audit.append(session, actor, "launched", f"runs/{asked.id}", None, on_record)
    return asked


def find_obstacle(session: Session, run: Run) -> str | None:
    """Say why no camera is chosen for a run's data now; None where one can be."""
    if run.choice_of is not None:
        return f"Run {run.id} is a camera-model choice for run {run.choice_of}, not a calibration; select a calibration run."
    if run.state not in TERMINAL_RUN_STATES:
        return f"Run {run.id} is {run.state}; choose a camera model after it has ended."
    for set_id in (run.telemetry_set_id, *run.joint_set_ids, run.validation_set_id):
        used = None if set_id is None else session.get_known(TelemetrySet, set_id)
        if used is not None and used.archived_utc is not None:
            return f"{used.name} was archived on {used.archived_utc[:10]}; upload it again to use it, then choose."
    return None


def find_choice_run(session: Session, run_id: int) -> Run | None:
    """Return the newest run that chooses a camera for a run's data, or None where nobody has asked."""
    return queries.find_choice(session, run_id)


def get_choice(session: Session, blobs: BlobStore, run_id: int) -> Choice:
    """Return the camera that was chosen for a run's data, with its evidence."""
    get_run(session, run_id)
    asked = find_choice_run(session, run_id)
    if asked is None:
        raise NotFoundError(
            f"No camera has been chosen for the data of run {run_id} yet: choose one on its page, under Distortion."
        )
    if asked.result_sha256 is not None:
        return read_choice(blobs, asked.result_sha256, run_id)
    if asked.state in TERMINAL_RUN_STATES:
        why = f" ({asked.reason.rstrip('.')})" if asked.reason else ""
        raise ConflictError(
            f"Run {asked.id}, which chooses a camera for run {run_id}, ended {asked.state}{why}; choose the camera again.",
            code="choice-failed",
        )
    raise ConflictError(
        f"Run {asked.id}, which chooses a camera for run {run_id}, is {asked.state}; wait until it ends."
    )


def _is_answered(blobs: BlobStore, asked: Run) -> bool:
    """Whether a choice has an answer that can be read."""
    if asked.result_sha256 is None:
        return False
    try:
        read_choice(blobs, asked.result_sha256)
    except ConflictError:
        return False
    return True
