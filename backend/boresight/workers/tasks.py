"""What a worker process does: read a run's inputs, calibrate, write the result, say how it ended.

A worker opens no database. It gets the addresses of files and values, puts the result into the blob folder under its
content address, and returns the address and the figures a list shows. So nothing is lost when whoever asked is gone,
and an attempt that is computed twice leaves the same bytes in the same place. A folder of blobs must be visible to every
worker under the same path; of an object store a worker gets the address, and has credentials and cache of its own.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypedDict, cast

import orjson

from boresight.calibration.settings import CalibrationSettings
from boresight.calibration.source import TelemetryFile
from boresight.errors import BoresightError, CancelledError
from boresight.settings import read_settings
from boresight.sky.catalogue import Catalogue, load_catalogue
from boresight.store.blob_places import BlobPlace
from boresight.store.blobs import BlobStore, open_blobs
from boresight.telemetry.sensors import parse_sensor
from boresight.workers.link import Link
from boresight.workers.scratch import scratch_of
from boresight.workers.spread import ClusterSpread
from boresight.workers.summary import summary_of

CALCULATION = "boresight.calibration.calibrate:calibrate"


class Inputs(TypedDict):
    """All that the computation of a run needs."""

    blob_address: str
    catalogue_folder: str
    table_sha256: str
    validation_sha256: str | None
    sensor_document: dict[str, Any]
    settings: dict[str, Any]


class Outcome(TypedDict):
    """How an attempt ended: the terminal state asked for, why, the result's address, and lines for the log."""

    run_id: int
    attempt: int
    state: str
    reason: str | None
    result_sha256: str | None
    result_bytes: int
    summary: dict[str, Any] | None
    log: list[str]


Work = tuple[int, int, Inputs]  # run id, attempt, inputs


def execute_group(group: list[Work], calculation: str = CALCULATION) -> list[Outcome]:
    """Compute several small runs one after the other in one task."""
    return [execute(run_id, attempt, inputs, calculation) for run_id, attempt, inputs in group]


def execute(run_id: int, attempt: int, inputs: Inputs, calculation: str = CALCULATION) -> Outcome:
    """Compute one run; whatever happens, the answer is an outcome.

    Parameters
    ----------
    run_id, attempt
        Which run, and under which attempt number it is held.
    inputs
        Addresses of the telemetry, the sensor as it was at launch, the calibration's settings.
    calculation
        `module:function` with the signature of `calibrate`.
    """
    link = Link(run_id, attempt)
    try:
        link.refuse_if_cancelled()
        return _succeeded(run_id, attempt, inputs, calculation, link)
    except CancelledError as error:
        return _ended(run_id, attempt, "CANCELLED", str(error) or "Stopped on request.")
    except BoresightError as error:
        faults = [str(fault) for fault in getattr(error, "faults", ())]
        return _ended(run_id, attempt, "FAILED", str(error), faults)
    except Exception as error:  # noqa: BLE001 - any defect of the computation ends its run, not the worker
        reason = f"The computation broke down, {type(error).__name__}: {error}"
        return _ended(run_id, attempt, "FAILED", reason, [traceback.format_exc()])


def _succeeded(run_id: int, attempt: int, inputs: Inputs, calculation: str, link: Link) -> Outcome:
    """Calibrate, put the result, and describe it."""
    begun_s = time.perf_counter()
    blobs = open_blobs(replace(_own_place(), address=inputs["blob_address"]))
    document = _calibrated(blobs, inputs, calculation, link)
    content = orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
    seconds = time.perf_counter() - begun_s
    summary = {**summary_of(orjson.loads(content)), "seconds": round(seconds, 4)}
    outcome = _ended(run_id, attempt, "SUCCEEDED", None, [f"Computed in {seconds:.2f} s: {summary['status']}."])
    return outcome | {"result_sha256": blobs.put(content), "result_bytes": len(content), "summary": summary}


def _calibrated(blobs: BlobStore, inputs: Inputs, calculation: str, link: Link) -> dict[str, Any]:
    """Read the inputs and call the calculation; a large set is left in its file, and computed by whoever is idle."""
    validation = inputs["validation_sha256"]
    source = TelemetryFile(blobs.path(inputs["table_sha256"]))
    held_out = None if validation is None else TelemetryFile(blobs.path(validation))
    large = source.large()
    with ExitStack() as stack:
        folders: dict[str, Any] = {}
        if large:
            scratch = Path(inputs["catalogue_folder"]).parent / "scratch"
            folder = stack.enter_context(scratch_of(scratch, link.run_id, link.attempt))
            spread = ClusterSpread(f"{link.run_id}-{link.attempt}", folder, link.cancelled)
            folders = {"scratch_folder": folder, "spread": spread}
        return _function(calculation)(
            source if large else source.read(),
            parse_sensor(inputs["sensor_document"]),
            _catalogue(inputs["catalogue_folder"]),
            CalibrationSettings.parse(inputs["settings"]),
            validation=held_out if held_out is None or held_out.large() else held_out.read(),
            report=link.report,
            cancelled=link.cancelled,
            cache_folder=Path(inputs["catalogue_folder"]),
            **folders,
        )


def _ended(run_id: int, attempt: int, state: str, reason: str | None, log: list[str] | None = None) -> Outcome:
    """Describe an end without a result."""
    return Outcome(
        run_id=run_id,
        attempt=attempt,
        state=state,
        reason=reason,
        result_sha256=None,
        result_bytes=0,
        summary=None,
        log=log or [],
    )


@cache
def _own_place() -> BlobPlace:
    """Where this process would keep files by its own settings: what it fetches is kept there."""
    return read_settings().blob_place


@cache
def _function(dotted: str) -> Callable[..., dict[str, Any]]:
    """Import `module:function`."""
    module, _, name = dotted.partition(":")
    return cast("Callable[..., dict[str, Any]]", getattr(import_module(module), name))


@cache
def _catalogue(folder: str) -> Catalogue:
    """Load the star catalogue once a process."""
    return load_catalogue(Path(folder))
