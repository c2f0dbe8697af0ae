"""The frames of a run, one at a time: computed when asked for, from the stored telemetry and what the run estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from boresight.calibration.calibration import Calibration, Trust
from boresight.calibration.frame_view import frame_view, read_run_states
from boresight.calibration.matching.rematch import compute_magnitude_limit
from boresight.calibration.options import CalibrationSettings
from boresight.console.runs import queries
from boresight.console.runs.service import find_calibration, get_run
from boresight.console.runs.tables import TERMINAL_RUN_STATES, Run
from boresight.console.telemetry.tables import TelemetrySet
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import table_path
from boresight.platform.db.sessions import Session
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.read.frames import FrameIndex, frame_index, joined_frame_index
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor

ORDERS = ("frame", "worst")


@dataclass(frozen=True)
class FrameLine:
    """A frame in a list."""

    id: int
    frame: int
    detections: int
    chi2_per_dof: float | None
    deviation: float | None


def get_frame_index(session: Session, blobs: BlobStore, run: Run, result: Calibration | None) -> FrameIndex:
    """Find the frames of a run's calibration sets, as its result numbers them; where parameters vary, those of the last pass."""
    first = session.get_known(TelemetrySet, run.telemetry_set_id)
    tables = {one.original_sha256: one.table_sha256 for one in (first, *queries.list_further_sets(session, run))}
    passes = [one for one in (result.inputs.passes if result else ()) if one.sha256 in tables]
    if result is not None and result.variation is not None:
        passes = [replace(one, frame_offset=0) for one in passes[-1:]]
    if not passes:
        return frame_index(table_path(blobs, first.table_sha256))
    return joined_frame_index(tuple((table_path(blobs, tables[str(one.sha256)]), one.frame_offset) for one in passes))


def list_frames(
    session: Session, blobs: BlobStore, run_id: int, *, order: str = "frame", limit: int, after: int = 0
) -> list[FrameLine]:
    """List a run's frames from index `after` on, by number, or by the result's list of worst frames."""
    run = get_run(session, run_id)
    result = _read_result(session, blobs, run)
    index, worst = get_frame_index(session, blobs, run, result), list_worst_frames(result)
    if order == "worst":
        return [
            _line(index, place, index.find_place(frame), worst)
            for place, frame in list(enumerate(worst, start=1))[after : after + limit]
        ]
    return [_line(index, place + 1, place, worst) for place in range(after, min(after + limit, len(index)))]


def list_worst_frames(result: Calibration | None) -> dict[int, tuple[float | None, float | None]]:
    """Return chi-square per degree of freedom and its deviate of the frames that a result keeps, worst first.

    Results from before `worst_frames` was kept have their innovations, of every frame or of a thousand evenly spaced.
    """
    trust = (result.trust if result else None) or Trust()
    if kept := trust.worst_frames:
        numbers = zip(kept.frame, kept.chi2_per_dof, kept.deviation, strict=True)
        return {frame: (chi2, deviation) for frame, chi2, deviation in numbers}
    if (former := trust.nis_over_time) is None:
        return {}
    known = [(frame, nis) for frame, nis in zip(former.frame, former.nis_per_dof, strict=True) if nis is not None]
    return {frame: (nis, None) for frame, nis in sorted(known, key=lambda pair: -pair[1])}


def _line(
    index: FrameIndex, place_in_list: int, place: int, worst: Mapping[int, tuple[float | None, float | None]]
) -> FrameLine:
    frame = int(index.frame[place])
    detections = int(index.first_row[place + 1] - index.first_row[place])
    return FrameLine(place_in_list, frame, detections, *worst.get(frame, (None, None)))


def get_frame(
    session: Session, blobs: BlobStore, catalogue: Catalogue, cache_folder: Path | None, run_id: int, frame: int
) -> dict[str, Any]:
    """Show one frame of a run under its old and new parameters."""
    run = get_run(session, run_id)
    result = _read_result(session, blobs, run)
    index = get_frame_index(session, blobs, run, result)
    place = index.find_place(frame)
    sensor = _with_limit(parse_sensor(run.sensor_document), index, catalogue)

    def read(neighbours: int) -> tuple[Telemetry, slice]:
        first = int(index.first_row[place] - index.first_row[max(place - neighbours, 0)])
        return index.read(place, neighbours), slice(
            first, first + int(index.first_row[place + 1] - index.first_row[place])
        )

    states = read_run_states(result or Calibration(status="running"), sensor, CalibrationSettings.parse(run.settings))
    around: Sequence[int | None] = [None, *index.frame[max(place - 1, 0) : place + 2].tolist(), None]
    here = around.index(frame)
    return {
        "run": run.id,
        "sensor": sensor.name,
        "method": run.method,
        "place": place + 1,
        "frames": len(index),
        "previous": around[here - 1],
        "next": around[here + 1],
        "rows": sensor.rows,
        "columns": sensor.columns,
        "partial": run.result_sha256 is None and result is not None,
        **frame_view(states, read, catalogue, cache_folder),
    }


def _read_result(session: Session, blobs: BlobStore, run: Run) -> Calibration | None:
    """Return the run's calibration, complete or partial; an empty one where there is none or it is void."""
    if run.state in TERMINAL_RUN_STATES and run.result_sha256 is None:
        return None
    return find_calibration(session, blobs, run.id)


def _with_limit(sensor: Sensor, index: FrameIndex, catalogue: Catalogue) -> Sensor:
    """Return the sensor with the magnitude limit that the whole set was matched with."""
    if sensor.magnitude_limit is not None:
        return sensor
    return replace(
        sensor, magnitude_limit=compute_magnitude_limit(sensor, catalogue, index.named_stars, index.typical_stars)
    )
