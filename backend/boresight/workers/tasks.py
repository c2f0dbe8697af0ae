"""The tasks of a worker process: read a run's inputs, calibrate, store the result, and return how it ended.

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
from dataclasses import asdict, replace
from functools import cache, lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypedDict, cast

import numpy as np
import orjson
from distributed.diagnostics.plugin import WorkerPlugin

from boresight.calibration.calibrate import Progress, calibrate
from boresight.calibration.calibration import Calibration, parse_calibration, to_plain
from boresight.calibration.choice.result import Choice
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.joint.prior import PriorSource
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.telemetry_pieces import StoredTable, TelemetryInput, is_large, read_whole
from boresight.cameras import CAMERA_MODELS, DEFAULT_CAMERA, CameraModel
from boresight.console.runs.queries import ClaimedPrior, ClaimedRun, ClaimedSet, Line, RunEnd
from boresight.disks import storage_error
from boresight.errors import BoresightError, CancelledError, CorruptFileError
from boresight.kernels.workshop import make_all
from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.opening import open_blobs
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import working_table
from boresight.platform.observability import logs
from boresight.platform.observability.logs import belonging_to
from boresight.platform.observability.traces import Span, Traces, get_traceparent, get_traces
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
    """A plugin that warms a worker when it appears.

    `ours` says that the process was started by this server, `cameras` which are registered, as far as that is known.
    """

    name = "boresight-warm-up"
    idempotent = True

    def __init__(
        self, catalogue_folder: str, *, ours: bool, cameras: Sequence[str] = (), log_format: str = "text"
    ) -> None:
        self.catalogue_folder = catalogue_folder
        self.ours = ours
        self.cameras = tuple(cameras)
        self.log_format = log_format

    def setup(self, worker: object) -> None:  # noqa: ARG002 - the interface gives it
        """Begin warming beside the worker's event loop, which must go on answering the scheduler."""
        if self.ours:  # Ctrl-C in a terminal reaches the whole process group; the server stops its workers itself
            logs.configure(self.log_format)
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=self._warm, daemon=True, name="warm").start()

    def _warm(self) -> None:
        """Warm this worker; after a failure only its first run is slow."""
        try:
            warm(Path(self.catalogue_folder), self.cameras)
        except Exception:
            log.exception("Kernels could not be precompiled on this worker; its first run will take longer")


def warm(catalogue_folder: Path, cameras: Sequence[str] = ()) -> None:
    """Compile the kernels for these cameras, else the default, and load them by calibrating a few synthetic stars."""
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
    """Simulate a few stars over the detector of a sensor at the celestial pole."""
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
TABLES = 2  # telemetry tables cached in a worker process, without those computed in pieces
CHOICE = "boresight.calibration.choice.choose:choose"


class Inputs(TypedDict):
    """The inputs of a run's computation, plain, so that they can be unpacked whatever else their reader knows."""

    blob_address: str
    catalogue_folder: str
    sets: list[dict[str, str]]  # fields of a `ClaimedSet` each: one, or those of a joint calibration
    validation: dict[str, str] | None
    prior: dict[str, Any] | None  # fields of a `ClaimedPrior`
    sensor_document: dict[str, Any]
    settings: dict[str, Any]
    chooses: bool  # a camera, instead of calibrating
    trace: tuple[str, str] | None  # the endpoint of traces, and the place of the span that it belongs to


Work = tuple[int, int, Inputs]  # run id, attempt, inputs
Keep = Callable[[Callable[[], str]], "Future[str]"]


def gather_inputs(settings: Settings, run: ClaimedRun, traceparent: str | None = None) -> Inputs:
    """Gather what a worker needs."""
    return Inputs(
        blob_address=settings.blob_location.address,
        catalogue_folder=str(settings.catalogue_folder),
        sets=[asdict(one) for one in run.sets],
        validation=None if run.validation is None else asdict(run.validation),
        prior=None if run.prior is None else asdict(run.prior),
        sensor_document=dict(run.sensor_document),
        settings=dict(run.settings),
        chooses=run.choice_of is not None,
        trace=None if traceparent is None else (settings.otlp_endpoint, traceparent),
    )


def execute_group(group: list[Work], calculation: str = CALCULATION) -> list[RunEnd]:
    """Compute several small runs one after the other in one task; each result is synced to the disk while the next computes."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="boresight-results") as keeper:
        computed = [execute(*work, calculation, keeper.submit) for work in group]
        return [_await_storing(end, sha256) for end, sha256 in computed]


def execute(
    run_id: int, attempt: int, inputs: Inputs, calculation: str, keep: Keep
) -> tuple[RunEnd, Future[str] | None]:
    """Compute one run; returns its end, whatever happens, and the address that its result will have."""
    endpoint, parent = inputs["trace"] or ("", None)
    told = {"boresight.run_id": run_id, "boresight.attempt": attempt}
    with belonging_to(run_id=run_id, attempt=attempt):
        traces = get_traces(endpoint, "boresight-worker")
        with traces.span("compute", parent, told, kind="CONSUMER") as span:
            found = _execute(run_id, attempt, inputs, calculation, _traced(keep, traces, span))
            if found[0].state == "FAILED":
                span.fail(found[0].reason or "FAILED")
            return found


def _traced(keep: Keep, traces: Traces, span: Span) -> Keep:
    """Store a result as a span of the run that it is of, wherever that is done."""

    def put_traced(put: Callable[[], str]) -> str:
        with traces.span("store result", span.traceparent):
            return put()

    return keep if not traces.on else lambda put: keep(partial(put_traced, put))


def _execute(
    run_id: int, attempt: int, inputs: Inputs, calculation: str, keep: Keep
) -> tuple[RunEnd, Future[str] | None]:
    """Compute one run."""
    link = Link(run_id, attempt)
    try:
        link.refuse_if_cancelled()
        return _succeeded(inputs, calculation, link, keep)
    except CancelledError as error:
        return RunEnd(run_id, attempt, "CANCELLED", str(error) or "Cancelled."), None
    except CorruptFileError as error:
        return RunEnd(run_id, attempt, "FAILED", str(error), corrupt_sha256=error.sha256 or None), None
    except BoresightError as error:
        faults = [Line.log(str(fault)) for fault in getattr(error, "faults", ())]
        return RunEnd(run_id, attempt, "FAILED", str(error), log=faults), None
    except Exception as error:  # noqa: BLE001 - any defect of the computation ends its run, not the worker
        of_disk = storage_error(error) if isinstance(error, OSError) else None
        if of_disk is not None:
            return RunEnd(run_id, attempt, "FAILED", str(of_disk)), None
        reason = f"The computation failed, {type(error).__name__}: {error}"
        return RunEnd(run_id, attempt, "FAILED", reason, log=[_traceback()]), None


def _await_storing(end: RunEnd, sha256: Future[str] | None) -> RunEnd:
    """Return an end with the address of its result, once that is stored."""
    if sha256 is None:
        return end
    try:
        return replace(end, result_sha256=sha256.result())
    except BoresightError as error:  # for example a full disk; the run has no result then
        return RunEnd(end.run_id, end.attempt, "FAILED", f"The result could not be stored. {error}")
    except Exception as error:  # noqa: BLE001 - a defect ends the run, not the worker
        reason = f"The result could not be stored, {type(error).__name__}: {error}"
        return RunEnd(end.run_id, end.attempt, "FAILED", reason, log=[_traceback()])


def _traceback() -> Line:
    """Return a log line with the traceback of the current exception."""
    return Line.log(traceback.format_exc(), level="error")


def _succeeded(inputs: Inputs, calculation: str, link: Link, keep: Keep) -> tuple[RunEnd, Future[str] | None]:
    """Calibrate or choose, begin to put the result, and describe it."""
    begun_s, begun_cpu_s = time.perf_counter(), time.thread_time()
    blobs = open_blobs(replace(_own_location(), address=inputs["blob_address"]), make=False)
    summary, document, word = (
        _chosen(blobs, inputs, link) if inputs["chooses"] else _calibrated(blobs, inputs, calculation, link)
    )
    content = orjson.dumps(document)
    seconds, cpu_seconds = time.perf_counter() - begun_s, time.thread_time() - begun_cpu_s
    took = {"seconds": round(seconds, 4), "cpu_seconds": round(cpu_seconds, 4)}
    told = Line.log(f"Computed in {seconds:.2f} s: {word}.", took)
    end = RunEnd(link.run_id, link.attempt, "SUCCEEDED", summary=summary | took, result_bytes=len(content), log=[told])
    return end, keep(lambda: blobs.put(content))


#: The figures that a list shows, the document that is stored, and in words how it ended.
Computed = tuple[dict[str, Any], dict[str, Any], str]


def _chosen(blobs: BlobStore, inputs: Inputs, link: Link) -> Computed:
    """Read the inputs and choose a camera."""
    source, validation = _open_telemetry(blobs, inputs), _find_validation(inputs)
    choice: Choice = _function(CHOICE)(
        source if is_large(source) else read_whole(source),
        parse_sensor(inputs["sensor_document"]),
        _catalogue(inputs["catalogue_folder"]),
        CalibrationSettings.parse(inputs["settings"]),
        validation=None if validation is None else _read_small(_table(blobs, validation.table_sha256)),
        report=lambda message, fraction: link.report(Progress(fraction, message, None)),
        cancelled=link.cancelled,
        cache_folder=Path(inputs["catalogue_folder"]),
    )
    chosen = choice.chosen
    summary = {"frames": choice.frames, "stars": choice.stars, "camera_model": chosen.camera_model, "free": chosen.free}
    return summary | {"sentence": choice.sentence}, choice.to_dict(), f"{chosen.camera_model} was chosen"


def _open_telemetry(blobs: BlobStore, inputs: Inputs) -> TelemetryInput:
    """Return what is calibrated: one set, or several as one; a large one is left in its files."""
    sets = _list_sets(inputs)
    if len(sets) == 1:
        return _read_small(_table(blobs, sets[0].table_sha256))
    return join_sets([NamedTelemetry(_table(blobs, one.table_sha256), one.name, one.original_sha256) for one in sets])


def _list_sets(inputs: Inputs) -> list[ClaimedSet]:
    return [ClaimedSet(**one) for one in inputs["sets"]]


def _find_validation(inputs: Inputs) -> ClaimedSet | None:
    return None if inputs["validation"] is None else ClaimedSet(**inputs["validation"])


def _read_prior(blobs: BlobStore, prior: ClaimedPrior, sensor: Sensor) -> PriorSource:
    """Read the calibration that a run starts from, of the sensor under whatever name it had then."""
    name, sha256 = prior.name, prior.result_sha256
    found = replace(parse_calibration(orjson.loads(blobs.read(sha256)), name), sensor=sensor.name)
    return PriorSource(found, name, sha256, frozenset(prior.held_sha256s), prior.ended_utc)


def _sha256s(inputs: Inputs) -> dict[str, str]:
    """Return the content addresses of what a run is made of, by the roles that the library gives them."""
    sets, validation, prior = _list_sets(inputs), _find_validation(inputs), inputs["prior"]
    found = {f"telemetry_{number}": one.original_sha256 for number, one in enumerate(sets, 1)}
    if len(sets) == 1:
        found = {"telemetry": sets[0].original_sha256}
    if validation is not None:
        found["validation"] = validation.original_sha256
    if prior is not None:
        found["prior"] = prior["result_sha256"]
    return found


def _read_small(table: StoredTable) -> Telemetry | StoredTable:
    """Read a table, or leave a large one in its file."""
    return table if table.large() else _telemetry(table)


def _calibrated(blobs: BlobStore, inputs: Inputs, calculation: str, link: Link) -> Computed:
    """Read the inputs and call the calculation; a large set is left in its file, and computed by whoever is idle."""
    validation, prior = _find_validation(inputs), inputs["prior"]
    source, sensor = _open_telemetry(blobs, inputs), parse_sensor(inputs["sensor_document"])
    with ExitStack() as stack:
        folders: dict[str, Any] = {}
        if is_large(source):
            scratch = Path(inputs["catalogue_folder"]).parent / "scratch"
            folder = stack.enter_context(make_scratch_folder(scratch, link.run_id, link.attempt))
            executor = ClusterExecutor(f"{link.run_id}-{link.attempt}", folder, link.cancelled)
            folders = {"scratch_folder": folder, "executor": executor}
        if inputs["trace"] is not None:
            folders["staged"] = partial(
                _tell_stage, get_traces(inputs["trace"][0], "boresight-worker"), get_traceparent()
            )
        calibration: Calibration = _function(calculation)(
            source,
            sensor,
            _catalogue(inputs["catalogue_folder"]),
            CalibrationSettings.parse(inputs["settings"]),
            validation=None if validation is None else _read_small(_table(blobs, validation.table_sha256)),
            prior=None if prior is None else _read_prior(blobs, ClaimedPrior(**prior), sensor),
            sha256s=_sha256s(inputs),
            report=link.report,
            cancelled=link.cancelled,
            cache_folder=Path(inputs["catalogue_folder"]),
            **folders,
        )
    summary = to_plain(summarise_run(calibration))
    return summary, calibration.to_dict(), str(summary["status"])


def _tell_stage(traces: Traces, parent: str | None, stage: str, seconds: float) -> None:
    """Add the span of a stage that is just over."""
    now_ns = time.time_ns()
    traces.tell_past(stage, parent, now_ns - round(1e9 * seconds), now_ns)


def _table(blobs: BlobStore, sha256: str) -> StoredTable:
    """Return the file of a telemetry table, and whether other machines see it."""
    return StoredTable(*working_table(blobs, sha256), shared=blobs.kept_at is None)


@cache
def _own_location() -> BlobLocation:
    """Return the blob location of this process's own settings, with its cache folder."""
    return read_settings().blob_location


@cache
def _function(dotted: str) -> Callable[..., Any]:
    """Import `module:function`."""
    module, _, name = dotted.partition(":")
    return cast("Callable[..., Any]", getattr(import_module(module), name))


@lru_cache(maxsize=TABLES)
def _telemetry(table: StoredTable) -> Telemetry:
    """Map a telemetry table, cached because a group often has several runs on one."""
    return table.read()


@cache
def _catalogue(folder: str) -> Catalogue:
    """Load the star catalogue once per process."""
    return load_catalogue(Path(folder))
