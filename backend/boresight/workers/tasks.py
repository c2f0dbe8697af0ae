"""What a worker process does: read a run's inputs, calibrate, write the result, say how it ended.

A worker opens no database. It gets the addresses of files and values, puts the result into the blob folder under its
content address, and returns the address and the figures a list shows. So nothing is lost when whoever asked is gone,
and an attempt that is computed twice leaves the same bytes in the same place. A folder of blobs must be visible to every
worker under the same path; of an object store a worker gets the address, and has credentials and cache of its own.

A process is made ready before its first run: kernels compiled or read from the cache, catalogue loaded. That is a plugin of the
scheduler, so that a worker that replaces a dead one is warmed as well; `boresight warm` does the same once an installation, so
that not even the first worker waits for the compiler.
"""

from __future__ import annotations

import logging
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np
import orjson
from distributed.diagnostics.plugin import WorkerPlugin

from boresight.calibration.calibrate import calibrate
from boresight.calibration.calibration import Calibration, to_plain
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import StoredTable
from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA, CameraModel
from boresight.console.runs.queries import ClaimedRun, Line, RunEnd
from boresight.disks import storage_error
from boresight.errors import BoresightError, CancelledError, CorruptFileError
from boresight.kernels.workshop import make_all
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import working_table
from boresight.settings import Settings, read_settings
from boresight.simulation.sensors import st16_sensor
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import Sensor, parse_sensor
from boresight.verdicts.verdict import summarise_run
from boresight.workers.cluster_executor import ClusterExecutor, make_scratch_folder
from boresight.workers.link import Link

log = logging.getLogger(__name__)

FRAMES, STARS = 3, 6


class WarmUp(WorkerPlugin):  # type: ignore[misc]  # distributed ships no types
    """Warm a worker when it appears.

    `ours` says that the process was started by this server, `cameras` which are registered, as far as that is known.
    """

    name = "boresight-warm-up"
    idempotent = True

    def __init__(self, catalogue_folder: str, *, ours: bool, cameras: Sequence[str] = ()) -> None:
        self.catalogue_folder = catalogue_folder
        self.ours = ours
        self.cameras = tuple(cameras)

    def setup(self, worker: object) -> None:  # noqa: ARG002 - the interface gives it
        """Begin warming beside the worker's event loop, which must go on answering the scheduler."""
        if self.ours:  # Ctrl-C in a terminal reaches the whole process group; the server stops its workers itself
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=self._warm, daemon=True, name="warm").start()

    def _warm(self) -> None:
        """Warm this worker; a failure only means that its first run is slow."""
        try:
            warm(Path(self.catalogue_folder), self.cameras)
        except Exception:
            log.exception("This worker could not be warmed; its first run will take longer")


def warm(catalogue_folder: Path, cameras: Sequence[str] = ()) -> None:
    """Compile what is not, for these cameras, else the default, and every estimator; calibrate a few made-up stars to load it."""
    wanted = [CAMERA_MODELS[name] for name in cameras if name in CAMERA_MODELS] or [DEFAULT_CAMERA]
    make_all([camera.state for camera in wanted])
    catalogue = load_catalogue(catalogue_folder)
    sensor = _with_camera(st16_sensor(1), wanted[0])
    calibrate(_few_stars(sensor), sensor, catalogue, CalibrationSettings())


def _with_camera(sensor: Sensor, camera: CameraModel) -> Sensor:
    """Give a sensor another camera, without distortion."""
    own, pitch = CAMERA_MODELS[sensor.camera_model], sensor.pixel_pitch_m
    return replace(
        sensor,
        camera_model=camera.name,
        initial=camera.plain(own.focal_px(sensor.initial, pitch), *own.principal_point(sensor.initial), pitch),
        typical_sigma=np.array(camera.default_typical_sigma),
        free=camera.parameter_names,
    )


def _few_stars(sensor: Sensor) -> Telemetry:
    """Scatter stars over the detector of a sensor at the celestial pole, in agreement with its parameters."""
    rng = np.random.default_rng(1)
    n = FRAMES * STARS
    row_px, col_px = rng.uniform(0, sensor.rows, n), rng.uniform(0, sensor.columns, n)
    s_d = CAMERA_MODELS[sensor.camera_model].directions(sensor.initial, row_px, col_px, sensor.pixel_pitch_m)
    return Telemetry(
        frame=np.repeat(np.arange(FRAMES), STARS),
        exposure=np.zeros(n, np.int64),
        row_px=row_px,
        col_px=col_px,
        star_id=np.tile(np.arange(1, STARS + 1), FRAMES),
        ra_rad=np.arctan2(s_d[:, 1], s_d[:, 0]) % (2 * np.pi),
        dec_rad=np.arcsin(s_d[:, 2]),
    )


CALCULATION = "boresight.calibration.calibrate:calibrate"
TABLES = 2  # kept in a worker process; none is so large that it is computed in pieces


class Inputs(TypedDict):
    """All that the computation of a run needs."""

    blob_address: str
    catalogue_folder: str
    table_sha256: str
    validation_sha256: str | None
    sensor_document: dict[str, Any]
    settings: dict[str, Any]


Work = tuple[int, int, Inputs]  # run id, attempt, inputs
Keep = Callable[[Callable[[], str]], "Future[str]"]


def gather_inputs(settings: Settings, run: ClaimedRun) -> Inputs:
    """Gather what a worker needs."""
    return Inputs(
        blob_address=settings.blob_place.address,
        catalogue_folder=str(settings.catalogue_folder),
        table_sha256=run.table_sha256,
        validation_sha256=run.validation_sha256,
        sensor_document=dict(run.sensor_document),
        settings=dict(run.settings),
    )


def execute_group(group: list[Work], calculation: str = CALCULATION) -> list[RunEnd]:
    """Compute several small runs one after the other in one task; each result is synced to the disk while the next computes."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="boresight-results") as keeper:
        computed = [execute(*work, calculation, keeper.submit) for work in group]
        return [_kept(end, sha256) for end, sha256 in computed]


def execute(
    run_id: int, attempt: int, inputs: Inputs, calculation: str, keep: Keep
) -> tuple[RunEnd, Future[str] | None]:
    """Compute one run; whatever happens, the answer is its end, and the address that its result will have."""
    link = Link(run_id, attempt)
    try:
        link.refuse_if_cancelled()
        return _succeeded(inputs, calculation, link, keep)
    except CancelledError as error:
        return RunEnd(run_id, attempt, "CANCELLED", str(error) or "Stopped on request."), None
    except CorruptFileError as error:
        return RunEnd(run_id, attempt, "FAILED", str(error), corrupt_sha256=error.sha256 or None), None
    except BoresightError as error:
        faults = [Line.log(str(fault)) for fault in getattr(error, "faults", ())]
        return RunEnd(run_id, attempt, "FAILED", str(error), log=faults), None
    except Exception as error:  # noqa: BLE001 - any defect of the computation ends its run, not the worker
        of_disk = storage_error(error) if isinstance(error, OSError) else None
        if of_disk is not None:
            return RunEnd(run_id, attempt, "FAILED", str(of_disk)), None
        reason = f"The computation broke down, {type(error).__name__}: {error}"
        return RunEnd(run_id, attempt, "FAILED", reason, log=[_traceback()]), None


def _kept(end: RunEnd, sha256: Future[str] | None) -> RunEnd:
    """Complete an end with the address of its result, once that is on the disk."""
    if sha256 is None:
        return end
    try:
        return replace(end, result_sha256=sha256.result())
    except BoresightError as error:  # a full disk, say: the run has no result then
        return RunEnd(end.run_id, end.attempt, "FAILED", f"The result could not be kept. {error}")
    except Exception as error:  # noqa: BLE001 - a defect ends the run, not the worker
        reason = f"The result could not be kept, {type(error).__name__}: {error}"
        return RunEnd(end.run_id, end.attempt, "FAILED", reason, log=[_traceback()])


def _traceback() -> Line:
    """Return the log's line for a defect, while it is caught."""
    return Line.log(traceback.format_exc(), level="error")


def _succeeded(inputs: Inputs, calculation: str, link: Link, keep: Keep) -> tuple[RunEnd, Future[str] | None]:
    """Calibrate, begin to put the result, and describe it."""
    begun_s, begun_cpu_s = time.perf_counter(), time.thread_time()
    blobs = open_blobs(replace(_own_place(), address=inputs["blob_address"]), make=False)
    calibration = _calibrated(blobs, inputs, calculation, link)
    content = orjson.dumps(calibration.to_dict())
    seconds, cpu_seconds = time.perf_counter() - begun_s, time.thread_time() - begun_cpu_s
    took = {"seconds": round(seconds, 4), "cpu_seconds": round(cpu_seconds, 4)}
    summary = to_plain(summarise_run(calibration)) | took
    told = Line.log(f"Computed in {seconds:.2f} s: {summary['status']}.", took)
    end = RunEnd(link.run_id, link.attempt, "SUCCEEDED", summary=summary, result_bytes=len(content), log=[told])
    return end, keep(lambda: blobs.put(content))


def _calibrated(blobs: BlobStore, inputs: Inputs, calculation: str, link: Link) -> Calibration:
    """Read the inputs and call the calculation; a large set is left in its file, and computed by whoever is idle."""
    validation = inputs["validation_sha256"]
    source = _table(blobs, inputs["table_sha256"])
    validation_table = None if validation is None else _table(blobs, validation)
    large = source.large()
    with ExitStack() as stack:
        folders: dict[str, Any] = {}
        if large:
            scratch = Path(inputs["catalogue_folder"]).parent / "scratch"
            folder = stack.enter_context(make_scratch_folder(scratch, link.run_id, link.attempt))
            executor = ClusterExecutor(f"{link.run_id}-{link.attempt}", folder, link.cancelled)
            folders = {"scratch_folder": folder, "executor": executor}
        return _function(calculation)(
            source if large else _telemetry(source),
            parse_sensor(inputs["sensor_document"]),
            _catalogue(inputs["catalogue_folder"]),
            CalibrationSettings.parse(inputs["settings"]),
            validation=validation_table
            if validation_table is None or validation_table.large()
            else _telemetry(validation_table),
            report=link.report,
            cancelled=link.cancelled,
            cache_folder=Path(inputs["catalogue_folder"]),
            **folders,
        )


def _table(blobs: BlobStore, sha256: str) -> StoredTable:
    """Find a table of telemetry; of an object store only this machine sees the file."""
    return StoredTable(*working_table(blobs, sha256), shared=blobs.kept_at is None)


@cache
def _own_place() -> BlobLocation:
    """Where this process would keep files by its own settings: what it fetches is kept there."""
    return read_settings().blob_place


@cache
def _function(dotted: str) -> Callable[..., Calibration]:
    """Import `module:function`."""
    module, _, name = dotted.partition(":")
    return cast("Callable[..., Calibration]", getattr(import_module(module), name))


@lru_cache(maxsize=TABLES)
def _telemetry(table: StoredTable) -> Telemetry:
    """Map a table; the few newest are kept, for a group often has several runs of one. Its content never changes."""
    return table.read()


@cache
def _catalogue(folder: str) -> Catalogue:
    """Load the star catalogue once a process."""
    return load_catalogue(Path(folder))
