"""Launching, stopping, archiving and reading runs: what one needs is fixed at launch, so that it can be computed again alike."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from boresight.calibration.calibration import Calibration, parse_calibration
from boresight.calibration.exports import Source, export_document, find_camera_format
from boresight.calibration.options import CalibrationSettings
from boresight.console import list_queries as lists
from boresight.console.fleet.tables import Sensor
from boresight.console.runs import queries
from boresight.console.runs.dry_runs import check_run_request, dry_run
from boresight.console.runs.results import read_result, refuse_choice
from boresight.console.runs.tables import RUN_STATES, TERMINAL_RUN_STATES, ArchivedRun, Run, RunEvent, parse_progress
from boresight.console.telemetry.tables import TelemetrySet, find_quality
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.telemetry.sensors import parse_sensor


def launch(  # noqa: PLR0913 - who launches what, and seven choices by name
    session: Session,
    actor: Actor,
    sensor_id: int,
    telemetry_set_id: int,
    settings: Mapping[str, Any],
    *,
    validation_set_id: int | None = None,
    joint_set_ids: Sequence[int] = (),
    prior_run_id: int | None = None,
    prior_set_id: int | None = None,
    label: str = "",
    validate_only: bool = False,
    forecast_sources: ForecastSources | None = None,
    initial: Mapping[str, Any] | None = None,
) -> Run | dict[str, Any]:
    """Queue a calibration of one set or of several as one, or only say what it would be.

    It starts from the sensor's parameters, or from a run or a parameter set with its covariance; `initial`: parameters to start
    from in place of the sensor file's, without a covariance.
    """
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    run_request = check_run_request(
        session,
        sensor_id,
        telemetry_set_id,
        settings,
        validation_set_id,
        label,
        joint_set_ids=joint_set_ids,
        prior_run_id=prior_run_id,
        prior_set_id=prior_set_id,
    )
    if validate_only:
        return dry_run(session, run_request, forecast_sources)
    columns = run_request.columns()
    if initial is not None:
        columns["sensor_document"] = {**columns["sensor_document"], "initial": dict(initial)}
    run = queries.add_run(session, **columns, launched_by=actor.user_id)
    audit.append(session, actor, "launched", f"runs/{run.id}", None, run_request.on_record())
    return run


def cancel(session: Session, actor: Actor, run_id: int, reason: str = "") -> Run:
    """Cancel a run: a QUEUED one ends at once, a RUNNING one as soon as it notices."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    refuse_control_characters(reason=reason)
    before = get_run(session, run_id).state
    if before in TERMINAL_RUN_STATES:
        raise ConflictError(f"Run {run_id} is {before} already; there is nothing to cancel.")
    said = f"Cancelled by {actor.printed_name}" + (f": {reason.strip()}" if reason.strip() else ".")
    queries.request_cancel(session, run_id, said)
    after = get_run(session, run_id)
    if after.state != before:
        audit.append(
            session, actor, "cancelled", f"runs/{run_id}", {"state": before}, {"state": after.state}, reason or None
        )
    return after


def archive_run(session: Session, actor: Actor, run_id: int) -> Run:
    """Have lists leave out a run that has ended; one that is archived stays so."""
    run = _get_archivable(session, actor, run_id)
    if run.state not in TERMINAL_RUN_STATES:
        raise ConflictError(f"Run {run_id} is {run.state}; wait until it has ended, or cancel it.")
    if queries.find_archived(session, run_id) is None:
        session.put(ArchivedRun(run_id=run_id, archived_utc=utc_now()))
        audit.append(session, actor, "archived", f"runs/{run_id}")
    return run


def restore_run(session: Session, actor: Actor, run_id: int) -> Run:
    """Have lists show a run again."""
    run = _get_archivable(session, actor, run_id)
    if (row := queries.find_archived(session, run_id)) is not None:
        session.delete(row)
        audit.append(session, actor, "restored", f"runs/{run_id}")
    return run


def _get_archivable(session: Session, actor: Actor, run_id: int) -> Run:
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    run = session.get_known(Run, run_id)
    refuse_choice(run)
    return run


def get_run(session: Session, run_id: int) -> Run:
    """Return a run."""
    run = queries.find_run(session, run_id)
    if run is None:
        raise NotFoundError(f"There is no run {run_id}; choose one from the list.")
    return run


def lacks_times(session: Session, run: Run) -> bool:
    """Whether a run has no result because its telemetry has no times, which the directions of its stars need."""
    if run.state != "FAILED":
        return False
    quality = find_quality(session.get_known(TelemetrySet, run.telemetry_set_id).quality)
    if any(found.code == "TIME_MISSING" and found.severity == "SERIOUS" for found in quality.findings):
        return True
    sensor = parse_sensor(run.sensor_document)
    return quality.time is None and (sensor.site is not None or sensor.declared.directions == "j2000")


def list_runs(
    session: Session,
    *,
    sensor_id: int | None = None,
    state: str | Collection[str] | None = None,
    method: str | None = None,
    telemetry_set_id: int | None = None,
    archived: bool = True,
    before_id: int | None = None,
    limit: int | None = None,
) -> list[Run]:
    """Return a page of runs, newest first; the next page starts before the last one's id."""
    asked = [state] if isinstance(state, str) else list(state or ())
    if strange := [word for word in asked if word not in RUN_STATES]:
        raise RefusedInputError(
            f"{', '.join(strange)} is not a state of a run; choose from {', '.join(RUN_STATES)}.", code="unknown-state"
        )
    return lists.list_newest(
        session,
        Run,
        before_id=before_id,
        limit=limit,
        sensor=sensor_id,
        method=method,
        data=telemetry_set_id,
        state=asked or None,
        in_use=None if archived else True,
    )


def count_by_state(session: Session) -> dict[str, int]:
    """Count the runs in every state, zero where there are none."""
    counted = queries.count_by_state(session)
    return {state: counted.get(state, 0) for state in RUN_STATES}


def find_result(session: Session, blobs: BlobStore, run_id: int) -> dict[str, Any] | None:
    """Return a run's calibration JSON, complete or partial, or None; with the true parameters of a simulated sensor as `truth`."""
    run = get_run(session, run_id)
    refuse_choice(run)
    document = parse_progress(run.progress).partial
    if run.result_sha256 is not None:
        document = read_result(blobs, run.result_sha256, run_id)
    if document is None:
        return None
    truth = session.get_one(Sensor, run.sensor_id).truth
    return _in_model_order(document if truth is None else {**document, "truth": truth})


def find_calibration(session: Session, blobs: BlobStore, run_id: int) -> Calibration | None:
    """Return a run's calibration, complete or so far, or None."""
    document = find_result(session, blobs, run_id)
    return None if document is None else parse_calibration(document)


def get_final_result(session: Session, blobs: BlobStore, run_id: int) -> dict[str, Any]:
    """Return the calibration JSON of a run that has ended with one."""
    run = get_run(session, run_id)
    document = find_result(session, blobs, run_id)
    if run.result_sha256 is None or document is None:
        raise ConflictError(
            f"Run {run_id} is {run.state} and has no result; wait until it ends, or launch it again.", code="no-result"
        )
    return document


def get_final_calibration(session: Session, blobs: BlobStore, run_id: int) -> Calibration:
    """Return the calibration of a run that has ended with one."""
    return parse_calibration(get_final_result(session, blobs, run_id))


def export_run(
    session: Session,
    blobs: BlobStore,
    run_id: int,
    form: str,
    allowed_px: float | None = None,
    *,
    with_residual: bool = False,
) -> tuple[bytes, str]:
    """Write the camera that a run found as another program's file, as `calibration.exports` does: its bytes and its name."""
    document, run, found = get_final_result(session, blobs, run_id), get_run(session, run_id), find_camera_format(form)
    described = run.sensor_document or session.get_one(Sensor, run.sensor_id).document
    source = Source(f"Run {run_id}", run.result_sha256, parse_sensor(described))
    content, _ = export_document(found, document, source, residual=with_residual, allowed_px=allowed_px)
    return content, f"run-{run_id}-{found.name}{found.suffixes[0]}"


def _in_model_order(document: dict[str, Any]) -> dict[str, Any]:
    """Put every object keyed by parameters into the order of the camera model; stored rows sort their keys."""
    names = document.get("parameter_names") or list(document.get("parameters") or ())
    ordered = {
        key: {name: value[name] for name in names}
        for key, value in document.items()
        if isinstance(value, dict) and set(value) == set(names)
    }
    return document | ordered


def frames_to_come(session: Session, run: Run) -> int | None:
    """Return how many frames a run takes in one after another; None where it takes them all at once."""
    if not CalibrationSettings.parse(run.settings).sequential:
        return None
    return session.get_known(TelemetrySet, run.telemetry_set_id).frames


def list_log_lines(session: Session, run_id: int, *, after_id: int = 0, limit: int | None = None) -> list[RunEvent]:
    """Return a run's log in order, from the line after `after_id`: all of it, or at most `limit` lines."""
    get_run(session, run_id)
    return queries.list_events(session, run_id, after_id, limit)
