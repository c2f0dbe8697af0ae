"""A mission in the store: calibrations of a sensor over months, drawn about a truth that may drift, as if they had been run."""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as rows
from boresight.console.parameter_sets.service import _add as add_parameter_set
from boresight.console.parameter_sets.tables import Promotion
from boresight.console.runs.tables import Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.sessions import Session, utc_now, utc_text

START = datetime(2026, 1, 1, tzinfo=UTC)
HOURS = 2.0
STARS = 4000


def compute_covariance(sensor: Sensor, share: float) -> np.ndarray:
    sigma = share * np.array(list(sensor.document["typical_sigma"].values()))
    k = len(sigma)
    return np.outer(sigma, sigma) * 0.5 ** np.abs(np.subtract.outer(np.arange(k), np.arange(k)))


def add_set(
    session: Session,
    sensor_id: int,
    day: float,
    *,
    temperature_c: float | None = None,
    timed: bool = True,
    stars: int = STARS,
    blobs: BlobStore | None = None,
) -> TelemetrySet:
    """Add a set; its file exists only in `blobs`, for stores whose files are looked at."""
    number = session.query(TelemetrySet).count() + 1
    sha256 = f"{number:064x}" if blobs is None else blobs.put(f"set {number}".encode())
    begins = START + timedelta(days=day)
    time = {"start_utc": utc_text(begins), "end_utc": utc_text(begins + timedelta(hours=HOURS))}
    warmth = None if temperature_c is None else {"smallest": temperature_c - 1, "largest": temperature_c + 1}
    size = 1 if blobs is None else blobs.size(sha256)
    session.add(Blob(sha256=sha256, size_bytes=size, media_type="text/csv", created_utc=utc_now()))
    session.flush()
    row = TelemetrySet(
        sensor_id=sensor_id,
        name=f"Day {day:g}",
        purpose="calibration",
        original_sha256=sha256,
        table_sha256=sha256,
        frames=200,
        stars=stars,
        quality={"time": time if timed else None, "temperature_c": warmth, "exposures": 400, "warnings": []},
        uploaded_utc=utc_now(),
    )
    session.add(row)
    session.flush()
    audit.append(session, COMMAND_LINE, "brought in", f"telemetry-sets/{row.id}")
    return row


def add_run(
    session: Session,
    telemetry: TelemetrySet,
    rng: np.random.Generator,
    shift: np.ndarray | float = 0.0,
    *,
    share: float = 0.05,
    method: str = "batch",
    state: str = "SUCCEEDED",
    **trend: Any,
) -> Run:
    sensor = session.get_one(Sensor, telemetry.sensor_id)
    names, initial = list(sensor.document["initial"]), np.array(list(sensor.document["initial"].values()))
    typical, C = np.array(list(sensor.document["typical_sigma"].values())), compute_covariance(sensor, share)
    scale = np.sqrt(np.diag(C))
    drawn = (
        initial
        + shift * typical
        + scale * (np.linalg.cholesky(C / np.outer(scale, scale)) @ rng.standard_normal(len(C)))
    )
    entry = {
        "camera_model": sensor.document["camera_model"],
        "names": names,
        "parameters": dict(zip(names, drawn.tolist(), strict=True)),
        "covariance": C.tolist(),
        "variance_factor": 1.0,
        "said": None,
        "left_out": None,
    }
    summary = {
        "status": "converged",
        "level": "normal",
        "stars": telemetry.stars,
        "rms_final_arc_rad": 8.2e-5 + 1e-7 * len(names),
    }
    run = Run(
        sensor_id=sensor.id,
        telemetry_set_id=telemetry.id,
        method=method,
        settings={"method": method},
        sensor_document=sensor.document,
        state=state,
        launched_utc=utc_now(),
        ended_utc=utc_now(),
        summary=summary | {"rms_initial_arc_rad": 2e-4, "trend": entry | trend},
    )
    session.add(run)
    session.flush()
    audit.append(session, COMMAND_LINE, "brought in", f"runs/{run.id}")
    return run


def make_baseline(session: Session, run: Run) -> int:
    sensor = session.get_one(Sensor, run.sensor_id)
    entry = (run.summary or {})["trend"]
    sigma = np.sqrt(np.diag(np.array(entry["covariance"]))).tolist()
    document = {
        "sensor": sensor.name,
        "camera_model": entry["camera_model"],
        "parameters": entry["parameters"],
        "sigma": dict(zip(entry["names"], sigma, strict=True)),
        "covariance": {"names": entry["names"], "matrix": entry["covariance"]},
        "method": "batch",
        "status": "converged",
        "advice": [],
        "run_id": run.id,
    }
    incumbent, now = rows.find_baseline(session, sensor.id), utc_now()
    if incumbent is not None:
        incumbent.ground_state, incumbent.baseline_to_utc = "SUPERSEDED", now
        session.flush()
    row = add_parameter_set(session, COMMAND_LINE, sensor, document, ground_state="BASELINE", run_id=run.id)
    row.baseline_from_utc = now
    session.add(Promotion(sensor_id=sensor.id, parameter_set_id=row.id, at_utc=now))
    session.flush()
    return row.id
